"""docs/exports.md: every command and every piece of code on it runs, in the order of the page."""

import importlib.util
import os
import re
import shlex
import shutil
from pathlib import Path

import pytest
from documented_commands import ROOT
from own_process import in_a_process_of_its_own
from typer.testing import CliRunner

from benchmark.cli.app import app

PAGE = (ROOT / "docs/exports.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(python)?\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
EACH = """
for number, code in enumerate(BLOCKS, start=1):
    print(f"block {number}", flush=True)
    exec(compile(code, f"docs/exports.md, block {number}", "exec"), {"__name__": "__main__"})
"""


@pytest.fixture(scope="module")
def exported(small_set, tmp_path_factory) -> Path:
    """A folder in which the commands of the page have run."""
    place = tmp_path_factory.mktemp("page")
    shutil.copytree(small_set, place / "out/set")
    commands = [line for language, block in BLOCKS if not language for line in block.splitlines()]
    assert len(commands) > 5
    before = Path.cwd()
    os.chdir(place)
    try:
        for command in commands:
            words = shlex.split(command)
            assert words[0] == "skybench"
            if words[1] != "generate":
                result = CliRunner().invoke(app, words[1:])
                assert result.exit_code == 0, result.output
    finally:
        os.chdir(before)
    return place


@pytest.mark.journey
def test_code_of_the_page_runs(exported) -> None:
    """All in one process, without a network: `datasets` and mlcroissant take seconds to load."""
    code = [block for language, block in BLOCKS if language]
    if importlib.util.find_spec("torch") is None:
        code = [block for block in code if "import torch" not in block]
    assert len(code) > 8
    in_a_process_of_its_own(
        f"BLOCKS = {code!r}\n{EACH}", cwd=exported,
        HF_HUB_OFFLINE="1", HF_HOME=str(exported / "hf"), PYTHONPATH=str(ROOT),
    )  # fmt: skip


def test_hub_images_are_those_of_the_dataset(exported) -> None:
    """Read as Parquet alone; the page's own code reads them with `datasets`."""
    import io

    import numpy as np
    import pyarrow.parquet as pq
    from PIL import Image

    from generator.dataset.reader import Dataset

    rows = [
        row
        for path in sorted((exported / "out/hub/frames").glob("*.parquet"))
        for row in pq.read_table(path).to_pylist()
    ]
    frames = list(Dataset.open(exported / "out/set"))
    assert len(rows) == len(frames) == 2
    for row, frame in zip(rows, frames, strict=True):
        with Image.open(io.BytesIO(row["image"]["bytes"])) as image:
            np.testing.assert_array_equal(np.asarray(image), frame.image)
        assert (row["index"], row["frame_id"]) == (frame.index, frame.frame_id)
