"""Make docs/tutorial.ipynb from docs/tutorial.md: the same words and commands, run, with their output.

Usage: python tools/tutorial_notebook.py   (skybench must be on the PATH; works in a temporary folder)
"""

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

import nbclient
import nbformat

DOCS = Path(__file__).parents[1] / "docs"
TUTORIAL, NOTEBOOK = DOCS / "tutorial.md", DOCS / "tutorial.ipynb"
NOT_RUN = "# not run by the tests"
SHOW_FIGURE = 'from IPython.display import SVG\n\nSVG("results/tutorial/leaderboard.svg")'
LONGEST_S = 600
_FENCED = re.compile(r"^```(\w+)\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_FILE = re.compile(r"# file: (\S+)\n")


@dataclass(frozen=True)
class Part:
    """A piece of the tutorial: words, commands for the shell, or a file to write (`path`)."""

    kind: str
    text: str
    path: str = ""


def parts_of(tutorial: str) -> list[Part]:
    """Split the tutorial into words, commands and files; commands marked as not to be run remain words."""
    parts, end = [], 0
    for block in _FENCED.finditer(tutorial):
        language, text = block.groups()
        named = _FILE.match(text)
        runs = language == "sh" and not text.startswith(NOT_RUN)
        if not runs and named is None:
            continue
        parts.append(Part("words", tutorial[end : block.start()].strip()))
        parts.append(Part("commands", text.strip()) if runs else Part("file", text.strip(), named.group(1)))
        end = block.end()
    parts.append(Part("words", tutorial[end:].strip()))
    return [part for part in parts if part.text]


def notebook_of(tutorial: str) -> nbformat.NotebookNode:
    """The tutorial as a notebook that has not been run."""
    cells = []
    for part in parts_of(tutorial):
        if part.kind == "words":
            cells.append(nbformat.v4.new_markdown_cell(part.text))
        elif part.kind == "file":
            cells.append(nbformat.v4.new_code_cell(f"%%writefile {part.path}\n{part.text}"))
        else:
            cells.append(nbformat.v4.new_code_cell(f"%%bash\nset -e\n{part.text}"))
    cells.append(nbformat.v4.new_code_cell(SHOW_FIGURE))
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})


def run(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """Run a notebook in a folder; progress bars and execution times are left out of what is kept."""
    client = nbclient.NotebookClient(
        notebook,
        timeout=LONGEST_S,
        resources={"metadata": {"path": str(folder)}},
        record_timing=False,
        coalesce_streams=True,
    )
    done = client.execute()
    for cell in done.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
        for output in cell.get("outputs", ()):
            if "text" in output:
                output["text"] = _COLOURS.sub("", output["text"])
    del done.metadata["language_info"]
    return done


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        nbformat.write(run(notebook_of(TUTORIAL.read_text(encoding="utf-8")), Path(folder)), NOTEBOOK)


if __name__ == "__main__":
    main()
