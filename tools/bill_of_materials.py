"""The bill of materials: every package of requirements.lock with its hashes and licence, as CycloneDX 1.6 in JSON.

    python tools/bill_of_materials.py OUT.json

Versions and hashes are those of the lock file; licences are those that the installed packages state. The same lock file and
packages give the same bytes. A component's scope says whether skybench requires it (`required`) or only its optional parts,
tests and builds do (`optional`).
"""

from __future__ import annotations

import re
import sys
import tomllib
import uuid
from importlib.metadata import PackageMetadata, PackageNotFoundError, distribution, requires
from pathlib import Path

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType, Property
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.model.license import LicenseAcknowledgement
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
UNKNOWN = "not stated"
_ENTRY = re.compile(r"^([a-z0-9][a-z0-9._-]*)==(\S+)(?: ; ([^\\\n]*?))?((?: \\\n +--hash=\S+)+)$", re.MULTILINE)
_STATED = re.compile(r"^\| ([a-z0-9][^ |]*)[^|]* \| (.+?) \|$", re.MULTILINE)
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")


def main(out: Path) -> None:
    """Write the bill of materials."""
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(bill(LOCK.read_text(encoding="utf-8")), encoding="utf-8")


def bill(lock: str) -> str:
    """Bill of materials for a lock file's text."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = closure([Requirement(line) for line in project["dependencies"]])
    itself = Component(
        name=project["name"],
        version=project["version"],
        type=ComponentType.APPLICATION,
        bom_ref=f"{project['name']}@{project['version']}",
        licenses=[LicenseFactory().make_from_string(project["license"])],
        purl=PackageURL("pypi", name=project["name"], version=project["version"]),
    )
    components = [component(*entry, needed) for entry in locked(lock)]
    made = Bom(components=components, serial_number=uuid.uuid5(uuid.NAMESPACE_URL, itself.bom_ref.value + lock))
    made.metadata.component = itself
    made.metadata.timestamp = None  # the same contents, the same bytes
    made.register_dependency(itself, [each for each in components if each.scope is ComponentScope.REQUIRED])
    return JsonV1Dot6(made).output_as_string(indent=1) + "\n"


def locked(lock: str) -> list[tuple[str, str, str, list[str]]]:
    """Name, version, condition of use, and SHA-256 of the files of each package in a lock file."""
    return [(name, version, use, sorted(_HASH.findall(rest))) for name, version, use, rest in _ENTRY.findall(lock)]


def component(name: str, version: str, use: str, hashes: list[str], needed: set[str]) -> Component:
    """Component of a package; its hashes are of all its files in the index, of which an installation uses one."""
    licence = licence_of(name)
    properties = {"skybench:used-where": use, "skybench:licence": licence if licence == UNKNOWN else ""}
    return Component(
        name=name,
        version=version,
        type=ComponentType.LIBRARY,
        bom_ref=f"{name}@{version}",
        purl=PackageURL("pypi", name=name, version=version),
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest) for digest in hashes],
        licenses=[LicenseFactory().make_from_string(licence, license_acknowledgement=LicenseAcknowledgement.DECLARED)]
        if licence != UNKNOWN
        else [],
        scope=ComponentScope.REQUIRED if name in needed else ComponentScope.OPTIONAL,
        properties=[Property(name=key, value=value) for key, value in properties.items() if value],
    )


def licence_of(package: str) -> str:
    """Licence that a package states here: an SPDX expression, else its classifiers, else the first line of its own text.

    THIRD_PARTY.md states it for packages that state none.
    """
    known = dict(_STATED.findall((ROOT / "THIRD_PARTY.md").read_text(encoding="utf-8")))
    try:
        stated: PackageMetadata = distribution(package).metadata
    except PackageNotFoundError:  # for another system
        return known.get(package, UNKNOWN)
    if stated.get("License-Expression"):
        return str(stated["License-Expression"])
    lines = [line.rsplit(" :: ")[-1] for line in stated.get_all("Classifier") or [] if line.startswith("License ::")]
    classifiers = [line for line in lines if line != "OSI Approved"]
    words = (stated.get("License") or "").strip().splitlines()
    return " AND ".join(classifiers) or known.get(package) or (words[0][:100] if words else UNKNOWN)


def closure(wanted: list[Requirement]) -> set[str]:
    """Canonical names of packages and of all that they require here."""
    found: set[str] = set()
    waiting = [(each, "") for each in wanted]
    while waiting:
        requirement, extra = waiting.pop()
        name = canonicalize_name(requirement.name)
        if name in found or (requirement.marker and not requirement.marker.evaluate({"extra": extra})):
            continue
        found.add(name)
        try:
            lines = requires(name) or []
        except PackageNotFoundError:  # for another system
            continue
        waiting += [(Requirement(line), each) for line in lines for each in ("", *requirement.extras)]
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]))
