"""Solver folders: the content of `solver.yaml`, and the revision of everything that determines a solver's behaviour."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

from platformdirs import user_cache_path
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from benchmark.errors import SolverError
from benchmark.solvers.program import Limits
from benchmark.solvers.revision import (
    PACKAGES,
    VIEW_MODULES,
    PackageTree,
    adapter_behaviour,
    file_digest,
    fusion_behaviour,
    installed_packages,
    revision_of,
)
from benchmark.wrong_key import wrong_key
from benchmark.yaml_file import read_yaml
from generator.scenario.strict import Strict, listed

FOLDER = Path(__file__).parent
SPEC_NAME = "solver.yaml"
README_NAME = "README.md"
"""What a folder says to readers; no part of a solver's behaviour."""
ENVIRONMENTS_VARIABLE = "SKYBENCH_ENVIRONMENTS"
LARGEST_SPEC_BYTES = 100_000
LARGEST_FOLDER_BYTES = 50_000_000
LARGEST_READ_BYTES = 4 << 30
"""Largest content of one place that a solver reads elsewhere."""
UNCOUNTED_FOLDERS = ("__pycache__", ".git")
"""Folders whose files do not count as a solver's; an isolated program finds them empty."""
AdapterName = Literal["celnav", "learned", "tetra3rs", "tetra3rs-calibrated", "ruststartracker", "zenith-fixer"]


class SolverSpec(Strict):
    """The content of ``solver.yaml``."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,59}$")]
    """Name in tables and in the names of folders."""
    title: Annotated[str, Field(min_length=5, max_length=120)]
    """Description in a few words."""
    licence: Annotated[str, Field(max_length=60)]
    """SPDX identifier."""
    adapter: AdapterName | None = None
    """One of the benchmark's own adapters; alternative to `command`."""
    install: Annotated[str, Field(max_length=120)] | None = None
    """Command that installs the packages of an adapter or the programs of a command."""
    requires: Annotated[
        tuple[Annotated[str, Field(pattern=r"^[a-z0-9-]{1,60}==[0-9][0-9a-z.]{0,30}$")], ...], BeforeValidator(listed)
    ] = ()
    """Packages that the adapter imports, each with its version: ``sep==1.4.1``. Results refer to these versions."""
    command: Annotated[tuple[str, ...], Field(max_length=50), BeforeValidator(listed)] = ()
    """Program that speaks docs/solver_protocol.md, started in the folder; ``python`` is that of its environment."""
    version: Annotated[str, Field(max_length=60)] | None = None
    """Version of the program, which must state the same in its hello."""
    programs: Annotated[
        tuple[Annotated[str, Field(pattern=r"^[A-Za-z0-9._+-]{1,60}$")], ...], BeforeValidator(listed)
    ] = ()
    """System programs that a command starts; `install` says how to get them."""
    environment: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,39}$")] | None = None
    """Name of a virtual environment built from the folder's requirements.txt; without it, skybench's own Python is used."""
    reads: Annotated[
        tuple[Annotated[str, Field(min_length=1, max_length=500)], ...], Field(max_length=20), BeforeValidator(listed)
    ] = ()
    """Files and folders outside its own folder that an isolated command needs; ``~`` is the user's home."""
    lens: Literal["any", "pinhole"] = "any"
    """Lenses that a command supports; ``pinhole`` gives it what a pinhole shows (`benchmark.run.pinhole_frames`)."""
    focal_retries: bool = False
    """Whether it is asked again with other focal lengths when it refuses (`benchmark.run.focal_retry`)."""
    fuses: Annotated[str, Field(min_length=1, max_length=500)] | None = None
    """Folder of another solver, relative to this one, instead of adapter and command: its positions for a sequence's frames
    go through one filter (`benchmark.solvers.fusion`). Its own ``solver.yaml`` says how it runs."""
    time_limit_s: Annotated[float, Field(gt=0, le=600)] = 10.0
    """Limit per frame."""
    memory_limit_mib: Annotated[int, Field(ge=64, le=1_000_000)] = 4096
    """Limit of the address space."""

    @model_validator(mode="after")
    def _one_way(self) -> SolverSpec:
        if [self.adapter is not None, bool(self.command), self.fuses is not None].count(True) != 1:
            raise ValueError("give either adapter or command or fuses")
        if self.fuses and (others := self.model_fields_set - {"name", "title", "licence", "fuses"}):
            raise ValueError(f"{', '.join(sorted(others))} cannot be beside fuses; the fused solver's own are taken")
        if self.command and self.version is None:
            raise ValueError("command needs version")
        if self.adapter and (self.version or self.environment):
            raise ValueError("version and environment belong to a command")
        if self.adapter and self.lens != "any":
            raise ValueError("lens belongs to a command")
        if self.adapter and self.reads:
            raise ValueError("reads belongs to a command")
        if self.command and self.requires:
            raise ValueError("requires belongs to an adapter; a command's packages are in its requirements.txt")
        return self

    @property
    def settings(self) -> dict[str, object]:
        """The settings that affect how it runs."""
        optional = {"programs": not self.programs, "lens": self.lens == "any", "focal_retries": not self.focal_retries}
        unused = {name for name, is_unused in optional.items() if is_unused}
        left_out = {"title", "licence", "install", "reads", "fuses", *unused}
        return self.model_dump(mode="json", exclude=left_out)


@dataclass(frozen=True)
class SolverFolder:
    """A solver as its folder describes it."""

    folder: Path
    spec: SolverSpec
    fused: SolverFolder | None = None
    """Another solver whose answers it fuses."""

    @property
    def name(self) -> str:
        """Name in tables and in the names of folders."""
        return self.spec.name

    @property
    def asked(self) -> SolverFolder:
        """The solver that is asked about each frame."""
        return self.fused or self

    @property
    def limits(self) -> Limits:
        """Limits of time and memory."""
        return Limits(time_s=self.spec.time_limit_s, memory_mib=self.spec.memory_limit_mib)

    @property
    def reads(self) -> list[Path]:
        """What an isolated program sees besides its folder and its interpreter."""
        return [Path(os.path.abspath(self.folder / Path(name).expanduser())) for name in self.spec.reads]

    @property
    def uncounted(self) -> list[Path]:
        """Files and folders in its folder that are no part of its behaviour, and that an isolated program finds empty."""
        places = [
            self.folder / README_NAME,
            *(place for name in UNCOUNTED_FOLDERS for place in self.folder.rglob(name)),
        ]
        return [place for place in places if place.exists()]

    def check_apart_from(self, truth: Iterable[Path]) -> None:
        """Refuse a definition that lets a program read folders of truth, in whole or in part.

        Parameters
        ----------
        truth : iterable of Path
            Folders, see `benchmark.frames.truth_folders`.

        Raises
        ------
        SolverError
        """
        for hidden in truth:
            real = Path(os.path.realpath(hidden))
            for shown in [self.folder, *self.reads]:
                place = Path(os.path.realpath(shown))
                where = "its folder" if shown == self.folder else f"{shown}, which its {SPEC_NAME} names in reads,"
                if real.is_relative_to(place):
                    raise SolverError(f"{self.name}: {where} contains the frames with their truth; keep them apart")
                if place.is_relative_to(real):
                    raise SolverError(f"{self.name}: {where} lies in {hidden}, beside the truth; keep them apart")

    def command_line(self) -> list[str]:
        """Command line that starts it.

        Raises
        ------
        SolverError
            Its environment has not been built, or a program that it needs is not installed.
        """
        if self.spec.adapter is not None:
            return [sys.executable, "-m", "benchmark.solvers.serve", self.name]
        absent = [name for name in self.spec.programs if shutil.which(name) is None]
        if absent:
            how = f"; install with: {self.spec.install}" if self.spec.install else ""
            raise SolverError(f"{self.name}: needs the program {' and '.join(absent)}{how}")
        program, *arguments = self.spec.command
        return [str(self._python()) if program == "python" else program, *arguments]

    def _python(self) -> Path:
        if self.spec.environment is None:
            return Path(sys.executable)
        place = environments_folder() / self.spec.environment
        python = place / "bin" / "python"
        if not python.is_file():
            raise SolverError(
                f"{self.name}: its environment {place} is missing; make it with: python3 -m venv {place} && "
                f"{python} -m pip install -r {self.folder / 'requirements.txt'}"
            )
        return python

    @cached_property
    def revision(self) -> str:
        """Revision of its behaviour, see `benchmark.solvers.revision`.

        Raises
        ------
        SolverError
            Its folder is too large, or a file of the adapter is not valid Python.
        """
        return self.revision_among(installed_packages())

    def revision_among(self, packages: PackageTree) -> str:
        """Its revision with the packages of another tree, such as a checkout of an older commit; raises as `revision`."""
        if self.fused is not None:
            fusing: dict[str, object] = {"name": self.name, "fuses": self.fused.revision_among(packages)}
            return revision_of(fusing, {}, fusion_behaviour(packages.sources), packages.catalogues)
        adapter = self.spec.adapter
        known = adapter is not None or self.folder.parent == packages.solvers
        left_out = {README_NAME}
        if known:
            left_out.add(SPEC_NAME)
        if adapter is not None:
            left_out |= {"__init__.py", "adapter.py"}  # its imports are covered by its modules
        names = {path.relative_to(self.folder).as_posix(): path for path in _files_of(self.folder)}
        files = {
            name: file_digest(path.read_bytes(), is_python=known and name.endswith(".py"))
            for name, path in names.items()
            if name not in left_out
        }
        if adapter is None and self.spec.lens == "pinhole":
            modules = packages.sources.modules
            files |= {f"{name}.py": file_digest(modules[name].encode(), is_python=True) for name in VIEW_MODULES}
        try:
            behaviour = None if adapter is None else adapter_behaviour(packages.sources, adapter, self.name)
            catalogues = "" if behaviour is None else packages.catalogues
        except (SyntaxError, ValueError, KeyError, OSError) as error:
            raise SolverError(f"{self.name}: its modules cannot be read ({error})") from error
        settings: dict[str, object] = self.spec.settings
        if read := self._read_elsewhere(packages):
            settings["read"] = read
        return revision_of(settings, files, behaviour, catalogues)

    def _read_elsewhere(self, packages: PackageTree) -> list[dict[str, str]]:
        """Digests of what it reads, without skybench's packages and its cache, where solvers keep tables that they make."""
        own = [packages.root / name for name in PACKAGES] + [user_cache_path("skybench")]
        real = [Path(os.path.realpath(place)) for place in self.reads if place.exists()]
        counted = [at for at in real if not any(at.is_relative_to(os.path.realpath(place)) for place in own)]
        return [_content(self.name, at) for at in counted]


def environments_folder() -> Path:
    """Folder of the programs' virtual environments: $SKYBENCH_ENVIRONMENTS, or a folder in the user's cache."""
    chosen = os.environ.get(ENVIRONMENTS_VARIABLE)
    return Path(chosen) if chosen else user_cache_path("skybench") / "environments"


def read_solver_folder(folder: Path) -> SolverFolder:
    """Read and check a solver's folder.

    Raises
    ------
    SolverError
        It contains no ``solver.yaml``, or an invalid one.
    """
    spec = _read_spec(folder)
    if spec.fuses is None:
        return SolverFolder(folder.resolve(), spec)
    place = folder / spec.fuses
    if not (place / SPEC_NAME).is_file():
        raise SolverError(f"{folder / SPEC_NAME}: fuses: no {SPEC_NAME} in {spec.fuses}; give another solver's folder")
    fused = _read_spec(place)
    if fused.fuses is not None:
        raise SolverError(f"{folder / SPEC_NAME}: fuses: {spec.fuses} fuses another; give the folder of that one")
    return SolverFolder(folder.resolve(), spec, SolverFolder(place.resolve(), fused))


def _read_spec(folder: Path) -> SolverSpec:
    path = folder / SPEC_NAME
    try:
        return SolverSpec.model_validate(read_yaml(path, LARGEST_SPEC_BYTES, SolverError))
    except ValidationError as error:
        raise SolverError(f"{path}: {wrong_key(error, SolverSpec)}") from error


def _files_of(folder: Path) -> list[Path]:
    files = _all_files(folder)
    size = sum(path.stat().st_size for path in files)
    if size > LARGEST_FOLDER_BYTES:
        raise SolverError(
            f"{folder}: holds {size} bytes, at most {LARGEST_FOLDER_BYTES} are allowed; keep large data in a folder that "
            f"{SPEC_NAME} names in reads"
        )
    return files


def _all_files(folder: Path) -> list[Path]:
    paths = (
        path for path in sorted(folder.rglob("*")) if not set(UNCOUNTED_FOLDERS) & set(path.relative_to(folder).parts)
    )
    return [path for path in paths if path.is_file()]


def _content(solver: str, place: Path) -> dict[str, str]:
    """SHA-256 of the files in a folder, or of a file, by name."""
    files = _all_files(place) if place.is_dir() else [place] if place.is_file() else []
    size = sum(path.stat().st_size for path in files)
    if size > LARGEST_READ_BYTES:
        raise SolverError(f"{solver}: reads: {place} holds {size} bytes; name folders of at most {LARGEST_READ_BYTES}")
    found = {}
    for path in files:
        with path.open("rb") as file:
            found[path.relative_to(place).as_posix()] = hashlib.file_digest(file, "sha256").hexdigest()
    return found


def solver_folders(root: Path) -> dict[str, SolverFolder]:
    """Find the solvers in a folder of solver folders, by name."""
    found = [read_solver_folder(path.parent) for path in sorted(root.glob(f"*/{SPEC_NAME}"))]
    return {solver.name: solver for solver in found}
