"""Links of all documents lead to files and headings that exist, as a forge shows them."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


def tool() -> ModuleType:
    """The module that the documentation's site uses, too."""
    path = ROOT / "tools" / "docs_site" / "document_links.py"
    spec = importlib.util.spec_from_file_location("document_links", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


LINKS = tool()


def tracked(*patterns: str) -> list[str]:
    """Files of the repository, those not yet committed included."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    except (OSError, subprocess.CalledProcessError):  # a source archive without its history
        listed = [path.relative_to(ROOT).as_posix() for pattern in patterns for path in ROOT.rglob(pattern)]
        listed = [name for name in listed if not name.startswith((".venv/", "out/"))]
    return sorted(name for name in set(listed) if (ROOT / name).is_file())


DOCUMENTS = tracked("*.md")


def faults(name: str, text: str) -> list[str]:
    """Links of a document that lead nowhere."""
    found = []
    for link in LINKS.links(text):
        if link.external:
            continue
        path, anchor = LINKS.resolve(name, link.target)
        place = ROOT / path
        if not place.exists():
            found.append(f"{name}:{link.line}: {link.target}: no such file")
        elif anchor and anchor not in LINKS.anchors(place.read_text(encoding="utf-8")):
            found.append(f"{name}:{link.line}: {link.target}: no such heading")
    return found


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_lead_to_files_and_headings(name: str) -> None:
    assert faults(name, (ROOT / name).read_text(encoding="utf-8")) == []


def test_the_documents_are_those_that_matter_and_hold_links() -> None:
    assert {"README.md", "CONTRIBUTING.md", "docs/index.md", "docs/tasks.md"} <= set(DOCUMENTS)
    assert sum(len(LINKS.links((ROOT / name).read_text(encoding="utf-8"))) for name in DOCUMENTS) > 60


def test_wrong_links_are_found() -> None:
    text = """\
[a](tasks.md) [b](missing.md) [c](tasks.md#splits) [d](tasks.md#no-such-heading) [e](https://example.org/x)
`[code](missing.md)`
```
[fenced](missing.md)
```
<img src="images/missing.png"> ![p](images/hello.jpg "title")
[reference]: ../missing.md
"""
    assert faults("docs/tutorial.md", text) == [
        "docs/tutorial.md:1: missing.md: no such file",
        "docs/tutorial.md:1: tasks.md#no-such-heading: no such heading",
        "docs/tutorial.md:6: images/missing.png: no such file",
        "docs/tutorial.md:7: ../missing.md: no such file",
    ]


def test_anchors_are_a_forge_s() -> None:
    text = """\
# Solvers as programs: `skybench-solver/1`
## Splits
## Splits
```
# not a heading
```
### frame-NNNNN.json: the *record*
"""
    assert LINKS.anchors(text) == {
        "solvers-as-programs-skybench-solver1",
        "splits",
        "splits-1",
        "frame-nnnnnjson-the-record",
    }


def test_documents_that_code_names_exist() -> None:
    named = {}
    for name in tracked("*.py", "*.html", "*.yaml", "*.yml", "Makefile"):
        for document in re.findall(r"\bdocs/[\w./-]+\.(?:md|ipynb)\b", (ROOT / name).read_text(encoding="utf-8")):
            named.setdefault(document, name)
    assert len(named) > 5
    assert {document: name for document, name in named.items() if not (ROOT / document).is_file()} == {}
