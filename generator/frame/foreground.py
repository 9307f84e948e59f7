"""Mitsuba shapes of a scenario's foreground: meshes from files, and a wall that represents a horizon profile."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.scenario.foreground_spec import ForegroundSpec, HorizonSpec, ShapeSpec
from generator.scenario.horizon_profile import elevation_deg, read_profile
from generator.scenario.mesh_file import mesh_description

Floats = NDArray[np.float64]

WALL_STEP_DEG = 0.25
"""Width of the wall's faces between the profile's own points: a chord deviates from the arc by at most 2.4e-6 of the
radius."""
LOWEST_DEG = -89.0
"""Elevation of the wall's foot, which hides the sky below the horizon almost to the nadir."""


def shape_dicts(spec: ForegroundSpec, mi: Any) -> dict[str, Any]:
    """Scene dictionary entries for everything in front of the sky."""
    parts: dict[str, Any] = {}
    if spec.horizon is not None:
        parts["horizon"] = _wall(spec.horizon, mi)
    for number, shape in enumerate(spec.shapes):
        parts[f"shape{number}"] = _mesh_from_file(shape, mi)
    return parts


def _surface(reflectance: float) -> dict[str, Any]:
    """A two-sided diffuse surface, equally bright at all wavelengths."""
    inside = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": reflectance}}
    return {"type": "twosided", "bsdf": inside}


def wall_mesh(profile: Floats, distance_m: float) -> tuple[Floats, NDArray[np.uint32]]:
    """Vertices (2 n, 3), m, and faces (2 n, 3) of a wall around the origin with a profile's elevations along its top."""
    azimuth = np.union1d(np.arange(0, 360, WALL_STEP_DEG), profile[:, 0] % 360)
    top = np.radians(elevation_deg(profile, azimuth))
    turn = np.radians(azimuth)
    east, north = distance_m * np.sin(turn), distance_m * np.cos(turn)
    foot = np.full(len(azimuth), distance_m * np.tan(np.radians(LOWEST_DEG)))
    vertices = np.concatenate(
        [np.stack([east, north, foot], axis=1), np.stack([east, north, distance_m * np.tan(top)], axis=1)]
    )
    here = np.arange(len(azimuth))
    after = np.roll(here, -1)
    count = len(azimuth)
    faces = np.concatenate(
        [np.stack([here, after, here + count], 1), np.stack([after, after + count, here + count], 1)]
    )
    return vertices, faces.astype(np.uint32)


def _wall(horizon: HorizonSpec, mi: Any) -> Any:
    vertices, faces = wall_mesh(read_profile(horizon.file), horizon.distance_m)
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(_surface(horizon.reflectance))
    mesh = mi.Mesh("horizon", len(vertices), len(faces), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.ravel())
    parameters.update()
    return mesh


def _mesh_from_file(shape: ShapeSpec, mi: Any) -> Any:
    place = mi.ScalarTransform4f().translate(list(shape.translate_m)).scale(shape.scale)
    return mi.load_dict(mesh_description(shape.file) | {"to_world": place, "bsdf": _surface(shape.reflectance)})
