"""Mesh files: whether Mitsuba can read them, and whether they are closed."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator import mitsuba_runtime
from generator.scenario.strict import InputFile

MOST_FACES = 5_000_000
"""Limits memory and the time of the search for open edges."""
LARGEST_HEADER_BYTES = 65536
KINDS = ("ply", "obj")


class MeshError(ValueError):
    """The file is not a usable mesh."""


@dataclass(frozen=True)
class MeshFacts:
    """Properties of a mesh: number of faces, and of edges that do not join exactly two of them."""

    faces: int
    open_edges: int


def mesh_description(file: InputFile) -> dict[str, Any]:
    """Return the file as a Mitsuba scene dictionary describes it.

    Raises
    ------
    MeshError
        The suffix is neither .ply nor .obj.
    """
    kind = Path(file.location).suffix.lower().removeprefix(".")
    if kind not in KINDS:
        raise MeshError(f"found '{file.path}', expected a .ply or .obj file")
    return {"type": kind, "filename": file.location}


@functools.lru_cache(maxsize=128)
def read_mesh(file: InputFile) -> MeshFacts:
    """Read a mesh with Mitsuba.

    Raises
    ------
    MeshError
        The mesh cannot be read, has no faces or too many, or has a coordinate that is not finite.
    """
    description = mesh_description(file)
    if description["type"] == "ply":
        _check_ply_header(file)
    vertices, faces = _vertices_and_faces(file, description)
    if not 1 <= len(faces) <= MOST_FACES:
        raise MeshError(f"'{file.path}' has {len(faces)} faces, expected 1 to {MOST_FACES}")
    if not np.isfinite(vertices).all():
        raise MeshError(f"'{file.path}' has coordinates that are not finite")
    if faces.max() >= len(vertices):
        raise MeshError(f"'{file.path}' has faces of vertex {faces.max()}, but only {len(vertices)} vertices")
    return MeshFacts(len(faces), count_open_edges(vertices, faces))


def _vertices_and_faces(file: InputFile, description: dict[str, Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return copies of a mesh's arrays, (n, 3) each, so that Mitsuba's own mesh does not outlive the call.

    If an error kept a mesh without faces alive, every later rendering would fail: Dr.Jit traces each call to a shape
    over all shapes of the process, and cannot gather from an empty array.
    """
    mi = mitsuba_runtime.start()
    try:
        # With face normals, Mitsuba does not use the faces' indices, which have not been checked at this point.
        parameters = mi.traverse(mi.load_dict(description | {"face_normals": True}))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].rsplit('": ', 1)[-1].strip()
        raise MeshError(f"'{file.path}' cannot be read as a mesh ({reason[:120]})") from error
    vertices, faces = parameters["vertex_positions"], parameters["faces"]
    return np.array(vertices).reshape(-1, 3), np.array(faces).reshape(-1, 3)


def _check_ply_header(file: InputFile) -> None:
    """Refuse a header that announces more elements than the file has bytes, for which Mitsuba would reserve memory."""
    with Path(file.location).open("rb") as stream:
        header = stream.read(LARGEST_HEADER_BYTES).partition(b"end_header")[0]
        size = stream.seek(0, 2)
    announced = [int(count) for count in re.findall(rb"^\s*element\s+\S+\s+(\d{1,18})", header, re.MULTILINE)]
    if not announced or sum(announced) > size:
        raise MeshError(
            f"'{file.path}' cannot be read as a mesh (its header announces {sum(announced)} elements in {size} bytes)"
        )


def count_open_edges(vertices: NDArray[Any], faces: NDArray[Any]) -> int:
    """Count the edges that do not join exactly two faces; vertices at the same place count as one."""
    _, merged = np.unique(vertices, axis=0, return_inverse=True)
    corners = merged.reshape(-1)[faces]
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return int((counts != 2).sum())
