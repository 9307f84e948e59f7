"""Photographs as the command `skybench twin` receives them: FITS files, and folders that `skybench import` wrote."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import PhotographError
from benchmark.place import Place
from benchmark.twin.given_files import check_photograph
from benchmark.twin.imported import ImportedFrame, imported_frames, read_imported, scene_of
from benchmark.twin.photograph import Photograph, name_of, read_photograph
from benchmark.twin.scene import Scene


@dataclass(frozen=True, eq=False)
class Source:
    """A photograph that is not read yet.

    Attributes
    ----------
    name : str
        Name of its twin.
    path : Path
        Path of a FITS file, or of a frame record.
    imported : ImportedFrame or None
        For a photograph of a dataset.
    """

    name: str
    path: Path
    imported: ImportedFrame | None = None

    def read(self, scene: Scene) -> tuple[Scene, Photograph]:
        """Read the photograph; return it after the scene of its camera.

        Raises
        ------
        PhotographError
            It cannot be read, or does not fit the scene.
        """
        if self.imported is None:
            check_photograph(self.path)
            site = scene.spec.site
            return scene, read_photograph(self.path, Place(site.latitude_deg, site.longitude_deg, site.height_m))
        photograph = read_imported(self.imported)
        return scene_of(scene, self.imported, photograph), photograph


def sources_of(paths: Sequence[Path]) -> list[Source]:
    """List the photographs of FITS files and folders.

    Raises
    ------
    PhotographError
        A folder holds no dataset of photographs.
    """
    sources: list[Source] = []
    for path in paths:
        if path.is_dir():
            sources += [Source(frame.name, frame.path, frame) for frame in imported_frames(path)]
        else:
            sources.append(Source(name_of(path), path))
    return sources


def check_names(sources: Sequence[Source]) -> None:
    """Refuse photographs of one name, whose twins would replace each other.

    Raises
    ------
    PhotographError
        The message names both files.
    """
    by_name: dict[str, Source] = {}
    for source in sources:
        if (other := by_name.setdefault(source.name, source)) is not source:
            raise PhotographError(
                f"{source.path}: its twin would be named twin-{source.name}, as that of {other.path} is; give each its own "
                "--out, or rename one"
            )
