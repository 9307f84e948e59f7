"""Make .venv from requirements.lock, with nothing but Python's standard library: python3 tools/bootstrap.py.

It does nothing when .venv is up to date. Where the system's Python comes without ensurepip (Debian without python3-venv), pip
itself is fetched from the package index, by its hash in requirements.lock.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import urllib.parse
import urllib.request
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv"
LOCK = ROOT / "requirements.lock"
STAMP = VENV / "skybench-installed"
INDEX = os.environ.get("PIP_INDEX_URL", "https://pypi.org/simple")


def main() -> None:
    if sys.version_info < (3, 11):
        sys.exit(f"skybench needs Python 3.11 or newer; {sys.executable} is {sys.version.split()[0]}. Set PYTHON=...")
    wanted = fingerprint()
    if STAMP.exists() and STAMP.read_text() == wanted:
        return
    print("installing into .venv (about 1.5 GB, a minute or two) ...", flush=True)
    shutil.rmtree(VENV, ignore_errors=True)
    has_pip = importlib.util.find_spec("ensurepip") is not None
    venv.create(VENV, with_pip=has_pip, symlinks=os.name != "nt")
    python = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    with tempfile.TemporaryDirectory() as folder:
        pip = [str(python), "-m", "pip"] if has_pip else [str(python), str(fetch_pip(Path(folder)) / "pip")]
        quiet = ["install", "--quiet", "--disable-pip-version-check"]
        run([*pip, *quiet, "--require-hashes", "--requirement", str(LOCK)])
        run([*pip, *quiet, "--no-deps", "--no-build-isolation", "--editable", str(ROOT)])
    supply_libatomic(python)
    STAMP.write_text(wanted)


def fingerprint() -> str:
    """Digest of what .venv depends on."""
    digest = hashlib.sha256(sys.version.encode())
    for path in (LOCK, ROOT / "pyproject.toml"):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def fetch_pip(folder: Path) -> Path:
    """Download the locked version of pip as a wheel (PEP 503 index), which Python can run without installation."""
    block = re.search(r"^pip==(\S+)((?:.*\\\n)+.*)", LOCK.read_text(), re.MULTILINE)
    if block is None:
        sys.exit("requirements.lock does not list pip; run `make lock`")
    name = f"pip-{block.group(1)}-py3-none-any.whl"
    hashes = set(re.findall(r"sha256:([0-9a-f]{64})", block.group(0)))
    try:
        page = f"{INDEX.rstrip('/')}/pip/"
        with urllib.request.urlopen(page, timeout=60) as answer:
            links = re.findall(r'href="([^"#]+)', answer.read().decode())
        link = next(link for link in links if link.endswith("/" + name))
        with urllib.request.urlopen(urllib.parse.urljoin(page, link), timeout=60) as answer:
            data = answer.read()
    except (OSError, StopIteration, ValueError) as error:
        sys.exit(f"cannot fetch pip ({error!r}); install it with your system: apt install python3-venv")
    if hashlib.sha256(data).hexdigest() not in hashes:
        sys.exit("the downloaded pip has another hash than requirements.lock; not used")
    path = folder / name
    path.write_bytes(data)
    return path


def supply_libatomic(python: Path) -> None:
    """Put libatomic next to the libraries that need it, where the system lacks it, as in a minimal Debian or Ubuntu.

    Dr.Jit's wheel and pip's LLVM link to libatomic.so.1 but do not include it (mitsuba-renderer/drjit issue 484). Its Debian
    package can be downloaded and unpacked without root privileges.
    """
    probe = subprocess.run([str(python), "-c", "import ctypes; ctypes.CDLL('libatomic.so.1')"], capture_output=True)
    if sys.platform != "linux" or probe.returncode == 0:
        return
    advice = (
        "libatomic.so.1 is missing; install it: apt install libatomic1 (Debian, Ubuntu), dnf install libatomic (Fedora)"
    )
    with tempfile.TemporaryDirectory() as folder:
        try:
            subprocess.run(
                ["apt-get", "--quiet=2", "download", "libatomic1"], cwd=folder, check=True, stderr=subprocess.DEVNULL
            )
            (package,) = Path(folder).glob("libatomic1_*.deb")
            subprocess.run(["dpkg-deb", "--extract", str(package), folder], check=True)
            library = next(path for path in Path(folder).rglob("libatomic.so.1") if path.exists())
        except (OSError, subprocess.CalledProcessError, ValueError, StopIteration):
            sys.exit(advice)
        needing = [*VENV.glob("lib/python*/site-packages/drjit"), *VENV.glob("lib/*-unknown-linux-gnu")]
        for place in needing:
            shutil.copyfile(library.resolve(), place / "libatomic.so.1")


def run(command: list[str]) -> None:
    """Run a command; stop with its exit status if it fails."""
    status = subprocess.run(command, check=False).returncode
    if status:
        sys.exit(f"installation failed (exit status {status}): {' '.join(command)}")


if __name__ == "__main__":
    main()
