"""The README's first screen does what it says."""

import io
import re
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_code_prints_what_the_readme_shows(tmp_path, monkeypatch) -> None:
    code, printed = re.search(r"```python\n(.*?)```\n\n```\n(.*?)```", README, re.DOTALL).groups()
    from generator.frame.render import render_dataset
    from generator.scenario.file import load_scenario

    render_dataset(load_scenario(ROOT / "scenes" / "00_hello.yaml"), tmp_path / "out" / "hello")
    monkeypatch.chdir(tmp_path)
    output = io.StringIO()
    with redirect_stdout(output):
        exec(compile(code, "README.md", "exec"), {})
    assert output.getvalue() == printed


def test_documents_that_it_links_to_exist() -> None:
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", README) if not link.startswith("http")]
    assert len(links) > 8
    missing = [link for link in links if not (ROOT / link).exists()]
    assert missing == []


def test_commands_that_it_lists_exist() -> None:
    for program in ("benchmark.cli.app", "celnav.cli"):
        listed = set(re.findall(r"`(?:skybench|celnav) ((?:bench )?[a-z]+)", README))
        code = f"import sys; from {program} import main; sys.argv = ['x', '--help']; main()"
        shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        names = {"benchmark.cli.app": {"render", "doctor", "demo"}, "celnav.cli": {"solve"}}[program]
        assert names <= listed
        for name in names:
            assert name in shown
