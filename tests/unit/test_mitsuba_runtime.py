"""Finding LLVM: what is tried, and that nothing broken takes the process down."""

import os
import subprocess
import sys

import pytest

from generator import mitsuba_runtime
from generator.errors import RuntimeUnavailableError


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | environment, check=False
    )


def test_the_library_from_pip_is_found_and_works() -> None:
    library = mitsuba_runtime.find_llvm()
    assert library.usable
    assert int(library.version.split(".")[0]) >= mitsuba_runtime.MINIMUM_LLVM


def test_a_broken_library_is_reported_not_fatal(tmp_path) -> None:
    broken = tmp_path / "libLLVM.so"
    broken.write_bytes(b"\x7fELF not really")
    code = (
        "from generator import mitsuba_runtime as m\n"
        "from generator.errors import RuntimeUnavailableError\n"
        "try: m.find_llvm()\n"
        "except RuntimeUnavailableError as error: print(error)\n"
    )
    run = run_python(code, DRJIT_LIBLLVM_PATH=str(broken))
    assert run.returncode == 0
    assert str(broken) in run.stdout
    assert "install LLVM >= 17" in run.stdout


def test_doctor_says_what_to_do_and_exits_1(tmp_path) -> None:
    run = run_python("from benchmark.cli.app import main; main()", DRJIT_LIBLLVM_PATH=str(tmp_path / "nowhere.so"))
    assert run.returncode == 2
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.argv = ['skybench', 'doctor']; from benchmark.cli.app import main; main()",
        ],
        capture_output=True,
        text=True,
        env=os.environ | {"DRJIT_LIBLLVM_PATH": str(tmp_path / "nowhere.so"), "COLUMNS": "200"},
        check=False,
    )
    assert run.returncode == 1
    assert "problem" in run.stdout
    assert "install LLVM" in run.stdout


def test_an_old_library_is_refused_by_its_version() -> None:
    """The probe asks the library's version before it runs a kernel; a demand for LLVM 999 stands for an old library."""
    path = mitsuba_runtime.find_llvm().path
    run = subprocess.run(
        [sys.executable, "-c", mitsuba_runtime._LLVM_PROBE, path, "999"], capture_output=True, text=True, check=True
    )
    version = run.stdout.strip().strip('"')
    assert version == mitsuba_runtime.find_llvm().version


def test_variant_can_be_asked_for(monkeypatch) -> None:
    monkeypatch.setenv(mitsuba_runtime.VARIANT_VARIABLE, "llvm_ad_spectral")
    assert mitsuba_runtime.choose_variant() == "llvm_ad_spectral"
    monkeypatch.setenv(mitsuba_runtime.VARIANT_VARIABLE, "scalar_rgb")
    with pytest.raises(RuntimeUnavailableError, match="scalar_rgb is not one of"):
        mitsuba_runtime.choose_variant()
    monkeypatch.setenv(mitsuba_runtime.VARIANT_VARIABLE, "cuda_ad_spectral")
    monkeypatch.setattr(mitsuba_runtime, "cuda_works", lambda: False)
    with pytest.raises(RuntimeUnavailableError, match="no GPU"):
        mitsuba_runtime.choose_variant()
