"""docs/submissions.md: its commands, in order, on a small dataset."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

from typer.testing import CliRunner
from unit.benchmark.fake_night import write_dataset
from unit.benchmark.stored import stored

from benchmark.cli.app import app

PAGE = Path(__file__).parents[2] / "docs" / "submissions.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_commands_of_the_page_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_dataset(tmp_path / "out" / "demo")
    (program,) = blocks("python")
    (tmp_path / "answer_set.py").write_text(program, encoding="utf-8")
    (commands,) = blocks("bash")
    ran = 0
    for line in commands.splitlines():
        tool, *arguments = shlex.split(line)
        if tool == "skybench":
            run = CliRunner().invoke(app, arguments)
            assert run.exit_code == 0, run.output
        else:
            assert tool == "python"
            path = [str(PAGE.parents[1])]
            subprocess.run([sys.executable, *arguments], check=True, env={"PYTHONPATH": path[0]}, timeout=300)
        ran += 1
    assert ran == 5
    (result,) = stored(tmp_path / "results" / "demo").values()
    assert (result.solver, len(result.frames)) == ("my-solver", 3)
    assert (tmp_path / "results" / "demo" / "site" / "index.html").is_file()
