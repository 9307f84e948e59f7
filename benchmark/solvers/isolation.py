"""What an isolated solver program may see: its folder, its interpreter, the system's libraries, the image."""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from celnav.cache import cache_dir

ISOLATED = "namespaces of its own: no network, no files but its own, its interpreter's and the image"
NOT_ISOLATED = "none"
SYSTEM = (
    "/usr", "/etc/alternatives", "/etc/ld.so.cache", "/etc/localtime", "/etc/nsswitch.conf", "/etc/passwd", "/etc/group",
    "/etc/fonts", "/etc/ssl/certs",
)  # fmt: skip
"""Programs, libraries and the system files that they look up."""
_LIBRARIES = ("site-packages", "dist-packages")
"""Names of the folders in which Python packages are installed."""
_PACKAGES = ("benchmark", "celnav", "generator")
_PROBE_S = 30.0


@functools.cache
def isolation_obstacle() -> str:
    """Why programs cannot be isolated on this system; empty where they can. Determined once, by isolating a program."""
    if sys.platform != "linux":
        return "namespaces are Linux's"
    guardian = Path(__file__).with_name("guardian.py")
    command = [
        sys.executable,
        "-I",
        "-S",
        str(guardian),
        "probe",
        *places_words(visible_places([sys.executable], Path("/usr"))),
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PROBE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["not permitted"])[-1][:200]


def visible_places(command: list[str], folder: Path, more: Iterable[Path] = ()) -> dict[str, str]:
    """Map what a program sees: absolute names inside to absolute names outside.

    Parameters
    ----------
    command : list of str
        Its command line.
    folder : Path
        Folder in which it is started, shown completely.
    more : iterable of Path
        Further folders and files.
    """
    program = Path(shutil.which(command[0], path=os.environ.get("PATH")) or command[0])
    places = [Path(name) for name in SYSTEM] + [folder.absolute(), *more]
    if program.is_absolute():
        places += _installation(program)
    if program == Path(sys.executable):
        # Adapters import skybench, and celnav keeps tables in its cache.
        root = Path(__file__).parents[2]
        # Packages may be outside of the environment: of the user, or of another one that a .pth file names.
        places += [Path(entry) for entry in sys.path if Path(entry).name in _LIBRARIES]
        places += [
            Path(sys.prefix),
            Path(sys.base_prefix),
            cache_dir(),
            *(root / name for name in _PACKAGES),
        ]
    return {str(place): os.path.realpath(place) for place in _outermost(places) if place.exists()}


def _installation(program: Path) -> list[Path]:
    """Folders to which an interpreter of a virtual environment, or a program, belongs."""
    environment = program.parent.parent
    if not (environment / "pyvenv.cfg").is_file():
        return [program.parent]
    real = Path(os.path.realpath(program)).parents[1]
    link = Path(os.readlink(program)) if program.is_symlink() else program
    return [environment, real, *([link.parents[1]] if link.is_absolute() else [])]


def _outermost(places: list[Path]) -> list[Path]:
    """Select the places that are not inside others; the root is excluded."""
    wanted = {place for place in places if len(place.parts) > 1}
    return sorted(place for place in wanted if not wanted & set(place.parents))


def places_words(places: dict[str, str]) -> list[str]:
    """Format places for a command line."""
    return [word for pair in places.items() for word in pair]
