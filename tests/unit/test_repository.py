"""The repository's own files agree: versions, addresses, the linters' revisions, continuous integration."""

import json
import re
import tomllib
from importlib.metadata import metadata, version
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import generator

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LOCK = (ROOT / "requirements.lock").read_text(encoding="utf-8")


def locked(package: str) -> str:
    """Version of a package in requirements.lock."""
    found = re.search(rf"^{re.escape(package)}==(\S+)", LOCK, re.MULTILINE)
    assert found, f"requirements.lock does not list {package}"
    return found.group(1)


def citation() -> dict[str, object]:
    return dict(yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8")))


def newest_change() -> tuple[str, str]:
    """Version and date (or "unreleased") of the first chapter of the changelog."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    found = re.search(r"^## (\S+) \((\d{4}-\d{2}-\d{2}|unreleased)\)$", text, re.MULTILINE)
    assert found, "CHANGELOG.md begins with a chapter such as `## 1.2.0 (2026-01-31)` or `## 1.2.0 (unreleased)`"
    return found.group(1), found.group(2)


def test_all_files_name_one_version() -> None:
    number, date = newest_change()
    assert {PROJECT["version"], citation()["version"], number, generator.__version__, version("skybench")} == {number}
    assert str(citation().get("date-released", "unreleased")) == date


def test_every_package_that_skybench_runs_on_has_its_licence_stated() -> None:
    """Against what the installed package says of itself, where it says a name of SPDX's list."""
    text = (ROOT / "THIRD_PARTY.md").read_text(encoding="utf-8").split("## Software that skybench runs on")[1]
    stated = {
        name.split(" ")[0]: licence for name, licence in re.findall(r"^\| ([a-z0-9][^|]*?) \| (.+?) \|$", text, re.M)
    }
    stated.pop("package")
    groups = [
        PROJECT["dependencies"],
        *(PROJECT["optional-dependencies"][name] for name in ("peers", "cluster", "heif", "raw")),
    ]
    needed = {canonicalize_name(Requirement(line).name) for group in groups for line in group}
    assert set(stated) == needed
    for package, licence in stated.items():
        expression = metadata(package).get("License-Expression", "")
        if re.fullmatch(r"[A-Za-z0-9.-]+", expression):
            assert expression in licence, package


def test_all_files_name_one_address() -> None:
    urls = PROJECT["urls"]
    assert set(urls) == {"Homepage", "Documentation", "Source", "Issues", "Changelog"}
    assert all(address.startswith(urls["Source"]) for address in urls.values())
    assert citation()["repository-code"] == urls["Source"]
    for name in ("Documentation", "Changelog"):
        assert (ROOT / urls[name].split("/blob/main/")[1]).is_file()


def test_hooks_lint_with_the_locked_revision_of_ruff() -> None:
    repositories = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    revisions = {entry["repo"]: entry.get("rev") for entry in repositories}
    assert revisions["https://github.com/astral-sh/ruff-pre-commit"] == f"v{locked('ruff')}"
    assert all(rev for repository, rev in revisions.items() if repository != "local")
    (mypy,) = next(entry["hooks"] for entry in repositories if entry["repo"] == "local")
    assert mypy["entry"] == ".venv/bin/mypy"


def test_continuous_integration_runs_the_targets_of_make_on_every_python() -> None:
    jobs = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))["jobs"]
    promised = [name.rsplit(" :: ")[-1] for name in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", name)]
    assert jobs["test"]["strategy"]["matrix"]["python-version"] == promised
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    called = {target for command in commands for target in re.findall(r"\bmake ([a-z-]+)", command)}
    assert {"lint", "test", "docs"} <= called <= targets
    local = set(re.findall(r"^make ([a-z-]+)", (ROOT / ".ci/run").read_text(encoding="utf-8"), re.MULTILINE))
    assert called == local
    made = r"test -s (\S+)"
    assert [path for command in commands for path in re.findall(made, command)] == re.findall(
        made, (ROOT / ".ci/run").read_text(encoding="utf-8")
    )


@pytest.mark.parametrize("name", ["bug", "physics", "submission"])
def test_issue_forms_ask_for_what_an_answer_needs(name: str) -> None:
    form = yaml.safe_load((ROOT / f".github/ISSUE_TEMPLATE/{name}.yml").read_text(encoding="utf-8"))
    assert {"name", "description", "body"} <= set(form)
    fields = {entry["id"]: entry for entry in form["body"]}
    assert all({"label"} <= set(entry["attributes"]) for entry in fields.values())
    required = {key for key, entry in fields.items() if entry.get("validations", {}).get("required")}
    wanted = {
        "bug": {"command", "observed", "machine"},
        "physics": {"published", "source", "scenario"},
        "submission": {"name", "task", "check"},
    }
    assert wanted[name] <= required


def dockerignored(name: str) -> bool:
    """Whether a file of the repository is kept from the container's build."""
    patterns = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    return name.split("/")[0] in patterns


def test_the_container_installs_the_wheel_and_starts_a_command_that_exists() -> None:
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    (entry,) = json.loads(re.search(r"^ENTRYPOINT (.*)$", text, re.MULTILINE).group(1))
    assert entry in PROJECT["scripts"]
    assert {image.split(":")[1] for image in re.findall(r"^FROM (\S+)", text, re.MULTILINE)} == {"3.12-slim"}
    assert "Programming Language :: Python :: 3.12" in PROJECT["classifiers"]
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]
    needed = ["pyproject.toml", PROJECT["readme"], *PROJECT["license-files"], *build["wheel"]["packages"]]
    for name in [*needed, *build["wheel"]["force-include"]]:
        assert (ROOT / name).exists()
        assert not dockerignored(name), name
    (extra,) = re.findall(r'"\$\{wheel\}\[([a-z]+)\]"', text)
    assert extra in PROJECT["optional-dependencies"]


def test_containers_and_readme_name_what_exists() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    addresses = re.findall(r"git\+(https://[\w./-]+)", readme)
    assert addresses
    assert set(addresses) == {PROJECT["urls"]["Source"]}
    assert set(re.findall(r"skybench\[([a-z]+)\]", readme)) <= set(PROJECT["optional-dependencies"])
    assert all((ROOT / name).is_file() for name in re.findall(r"docker build .*-f (\S+)", readme))
    started = re.findall(r"(?:docker run .*?skybench|skybench'? skybench) ([a-z]+)", readme)
    assert started
    assert set(started) <= {"demo"}
    development = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text(encoding="utf-8"))
    assert (ROOT / re.search(r"python (\S+)", development["postCreateCommand"]).group(1)).is_file()
    assert "skybench doctor" in development["postCreateCommand"]
    schemas = development["customizations"]["vscode"]["settings"]["yaml.schemas"]
    assert all(
        (ROOT / schema).is_file() and all(any(ROOT.glob(each)) for each in files) for schema, files in schemas.items()
    )


def test_zenodo_and_the_citation_say_the_same() -> None:
    """Zenodo reads .zenodo.json in place of CITATION.cff where both exist."""
    deposit, cited = json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8")), citation()
    for key in ("title", "version", "license", "keywords"):
        assert deposit[key] == cited[key]
    assert [creator["name"] for creator in deposit["creators"]] == [author["name"] for author in cited["authors"]]
    assert deposit["upload_type"] == cited["type"]
    assert deposit["related_identifiers"][0]["identifier"] == cited["repository-code"]


def test_the_layout_names_every_folder_and_no_other() -> None:
    """CONTRIBUTING.md: the repository's folders at the left, the rooms of the packages below theirs."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    block = re.search(r"^## Layout\n\n```\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert block, "CONTRIBUTING.md has no block of the layout"
    found: dict[str, set[str]] = {}
    for line in block[1].splitlines():
        if not line.startswith(" "):
            top = line.split("/")[0]
            found[top] = set()
        else:
            found[top] |= set(re.findall(r"(?<=  )([a-z_]+)/(?= )", line))
    packages = ("generator", "celnav", "benchmark")
    tracked = {path for path in ROOT.iterdir() if path.is_dir() and path.name[0] not in "._" and path.name != "out"}
    ignored = {line.strip().strip("/") for line in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()}
    assert set(found) == {path.name for path in tracked} - ignored
    for package in packages:
        rooms = {path.name for path in (ROOT / package).iterdir() if path.is_dir() and path.name[0] not in "._"}
        assert found[package] == rooms, package


def test_the_number_of_frames_that_a_measurement_renders_is_told() -> None:
    from generator.dataset.forecast import FRAMES_MEASURED

    words = {3: "three", 4: "four", 5: "five"}[FRAMES_MEASURED]
    text = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8").replace("\n", " ")
    assert f"with `--measure` it renders {words} frames" in text
