"""docs/journeys.md shows what its commands print: typed anew, they print the same but for times."""

import importlib.util
import os
import stat
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "journeys.md"


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("journeys", ROOT / "tools" / "journeys.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def typed(tool, page: str) -> list:
    return [one for part in tool.parts_of(page) if isinstance(part, list) for one in part]


def test_numbers_that_vary_do_not_count_and_others_do(tool) -> None:
    seen, again, other = (
        tool.Typed("x", f"a@{sha} │ 3 frames in {s} s ── {km} km\n")
        for sha, s, km in (("0123456789ab", 2, 7), ("ba9876543210", 15.2, 7), ("0123456789ab", 2, 8))
    )
    assert seen.without_times == again.without_times != other.without_times


@pytest.mark.journey
def test_the_journeys_are_as_they_are_told(tool, tmp_path, monkeypatch) -> None:
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, module in (("skybench", "benchmark.cli"), ("celnav", "celnav.__main__")):
        shim = programs / name
        code = f"import sys; sys.argv[0] = '{name}'; from {module} import main; sys.exit(main())"
        shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{code}" "$@"\n', encoding="utf-8")
        shim.chmod(shim.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", os.pathsep.join([str(programs), str(Path(sys.executable).parent), os.environ["PATH"]]))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    folder = tmp_path / "work"
    folder.mkdir()
    page = PAGE.read_text(encoding="utf-8")
    told, now = typed(tool, page), typed(tool, tool.run_page(page, folder))
    assert len(told) >= 15
    for before, after in zip(told, now, strict=True):
        assert after.command == before.command
        assert after.without_times == before.without_times, f"{before.command}: run python tools/journeys.py"
