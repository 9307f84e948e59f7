"""The bill of materials: valid CycloneDX, every locked package with its hashes, licences of all that skybench runs on."""

from __future__ import annotations

import importlib.util
import json
import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

pytest.importorskip("cyclonedx")
ROOT = Path(__file__).parents[2]
LOCK = (ROOT / "requirements.lock").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def text() -> str:
    spec = importlib.util.spec_from_file_location("bill_of_materials", ROOT / "tools/bill_of_materials.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made = module.bill(LOCK)
    assert module.bill(LOCK) == made  # no date, no random number
    return made


def test_it_is_valid_cyclonedx(text) -> None:
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text.replace('"library"', '"book"')) is not None


def test_every_locked_package_is_there_with_all_its_hashes(text) -> None:
    listed = {(each["name"], each["version"]): each for each in json.loads(text)["components"]}
    lines = re.findall(r"^([a-z0-9._-]+)==(\S+)", LOCK, re.MULTILINE)
    assert set(listed) == set(lines)
    assert len(lines) > 200
    hashes = {digest["content"] for each in listed.values() for digest in each["hashes"]}
    assert hashes == set(re.findall(r"sha256:([0-9a-f]{64})", LOCK))
    assert all(each["purl"] == f"pkg:pypi/{name}@{version}" for (name, version), each in listed.items())


def test_what_skybench_runs_on_is_marked_and_has_a_licence(text) -> None:
    components = json.loads(text)["components"]
    required = [each for each in components if each["scope"] == "required"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = {canonicalize_name(Requirement(line).name) for line in project["dependencies"]}
    assert named <= {each["name"] for each in required}
    assert not {"pytest", "ray", "mypy", "sep"} & {each["name"] for each in required}
    assert [each["name"] for each in required if not each.get("licenses")] == []
