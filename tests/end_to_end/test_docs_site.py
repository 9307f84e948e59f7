"""`make docs` in small: a site of a few pages, made with the project's own MkDocs configuration and hooks."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from browser import chromium

ROOT = Path(__file__).parents[2]
INDEX = """\
# Home

[tasks](tasks.md#frames) [readme](../README.md) [scenes](../scenes) [more](../CONTRIBUTING.md)
"""
CAMERA = '''\
"""Cameras."""


def focal_px(hfov_deg: float) -> float:
    """Focal length (px).

    Parameters
    ----------
    hfov_deg
        Field of view.
    """
    return hfov_deg


def _hidden() -> None:
    """Private."""
'''
WRONG_DOCSTRING = '''


def other() -> None:
    """Short.

    Parameters
    ----------
    absent
        No such parameter.
    """
'''
PAGES = {
    "docs/index.md": INDEX,
    "docs/tasks.md": "# Tasks\n\n## Frames\n\nFrames hold scintillation.\n",
    "docs/api/index.md": "# API reference\n",
    "CONTRIBUTING.md": "# Contributing\n\n[tasks](docs/tasks.md) [make](Makefile)\n",
    "CHANGELOG.md": "# Changelog\n",
    "THIRD_PARTY.md": "# Credits\n",
    "SECURITY.md": "# Security\n",
    "README.md": "# Readme\n",
    "Makefile": "",
    "scenes/hello.yaml": "",
    "celnav/__init__.py": '"""Positions."""\n',
    "celnav/camera.py": CAMERA,
    "generator/__init__.py": '"""Frames."""\n',
    "benchmark/__init__.py": '"""Judgement."""\n',
}
NAV = """
nav:
  - Home: index.md
  - tasks.md
  - API reference:
      - api/index.md
  - Project: [contributing.md, security.md, changelog.md, third_party.md]
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with the project's configuration and hooks, and few pages."""
    for name, text in PAGES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    shutil.copytree(ROOT / "docs/assets", tmp_path / "docs/assets")
    shutil.copytree(ROOT / "tools/docs_site", tmp_path / "tools/docs_site")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    (tmp_path / "mkdocs.yml").write_text(settings.split("\nnav:\n")[0] + NAV, encoding="utf-8")
    return tmp_path


def build(project: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, check=False)


def test_pages_of_the_site_link_to_each_other_and_to_the_repository(project: Path) -> None:
    done = build(project)
    assert done.returncode == 0, done.stderr
    home = (project / "out/docs/index.html").read_text(encoding="utf-8")
    for address in (
        'href="tasks.html#frames"',
        'href="https://github.com/skybench/skybench/blob/main/README.md"',
        'href="https://github.com/skybench/skybench/tree/main/scenes"',
        'href="contributing.html"',
    ):
        assert address in home
    contributing = (project / "out/docs/contributing.html").read_text(encoding="utf-8")
    assert 'href="tasks.html"' in contributing
    assert 'href="https://github.com/skybench/skybench/blob/main/Makefile"' in contributing
    room = (project / "out/docs/api/rooms/celnav.html").read_text(encoding="utf-8")
    assert 'id="celnav.camera.focal_px"' in room
    assert "Field of view." in room
    assert "_hidden" not in room


@pytest.mark.parametrize(
    ("document", "text", "complaint"),
    [
        ("docs/tasks.md", "\n[lost](missing.md)\n", "missing.md"),
        ("docs/tasks.md", '\n<script src="https://example.org/x.js"></script>\n', "from the network"),
        *(
            pytest.param(*each, marks=pytest.mark.journey)
            for each in (
                ("docs/tasks.md", "\n[lost](../missing.md)\n", "missing.md"),
                ("docs/index.md", "\n[lost](tasks.md#missing)\n", "#missing"),
                ("docs/tasks.md", "\n![picture](https://example.org/x.png)\n", "from the network"),
                ("docs/assets/site.css", '\n@import "https://example.org/font.css";\n', "from the network"),
                ("docs/physics.md", "# A page that no menu lists\n", "physics.md"),
                ("celnav/camera.py", WRONG_DOCSTRING, "absent"),
            )
        ),
    ],
)
def test_faults_fail_the_build(project: Path, document: str, text: str, complaint: str) -> None:
    with (project / document).open("a", encoding="utf-8") as file:
        file.write(text)
    done = build(project)
    assert done.returncode != 0
    assert complaint in done.stdout + done.stderr


def test_search_works_from_disk_without_the_network(project: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    assert build(project).returncode == 0
    with chromium(tmp_path_factory.mktemp("profile")) as driver:
        driver.get((project / "out/docs/index.html").as_uri() + "?q=scintillation")
        driver.implicitly_wait(20)
        hit = driver.find_element("css selector", ".md-search-result__link[href*='tasks.html']")
        assert "Tasks" in hit.get_attribute("textContent")
        events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
        asked = [
            event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"
        ]
        assert [url for url in asked if url.startswith(("http:", "https:", "ws:", "wss:"))] == []
        assert [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"] == []
