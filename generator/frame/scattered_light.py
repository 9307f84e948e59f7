"""Light that a frame's lens scatters, from its sky and its points, inside and around the frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import FramePlan
from generator.optics.dust import dust_shadows
from generator.optics.light_cells import cells_outside
from generator.optics.scratches import scratch_light
from generator.optics.stray_light import PointSources, Surround, cell_grid, ghosts, stray_light
from generator.scenario.camera_spec import CameraSpec
from generator.seeds import random_stream
from generator.sensor.colour import filter_tile

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


GROUP_PX = 16.0
"""Side of the cells in which faint stars are gathered for the computation of stray light."""


@dataclass(frozen=True)
class Shining:
    """An emitter of points of light, and where its light goes.

    Attributes
    ----------
    emitter : StarEmitter or Groups
    tracks : generator.plugins.star_tracks.StarTracks or GroupTracks
    on_axis_e : (n, channels) array
        Electrons of each point on the axis.
    """

    emitter: Any
    tracks: Any
    on_axis_e: Floats


@dataclass(frozen=True)
class Groups:
    """Groups of points of light with the attributes of an emitter that stray light needs.

    Attributes
    ----------
    directions_at_middle : (n, 3) array
        Unit vectors.
    """

    directions_at_middle: Floats
    light_share: None = None
    behind_foreground: bool = True

    @property
    def count(self) -> int:
        """Number of groups."""
        return len(self.directions_at_middle)

    def open_share(self, group: Any, first: Any, last: Any) -> Floats:
        """Always 1: the Moon is not taken into account, nor anything else that hides members of groups."""
        del group, last
        return np.ones(len(first))


@dataclass(frozen=True)
class GroupTracks:
    """Places where the light of groups falls, with the attributes of :class:`generator.plugins.star_tracks.StarTracks`."""

    u_px: Floats
    v_px: Floats
    light: Floats
    star: NDArray[np.int64]
    u: Floats
    v: Floats
    weight: Floats


def gathered(one: Shining, camera: CameraSpec) -> Shining:
    """Gather points into groups of the same total light.

    A group is a cell of the sky that is GROUP_PX wide on the axis, inside or outside the frame. It shines from its mean
    place, weighted by light, regardless of anything that hides parts of it.
    """
    towards, tracks = one.emitter.directions_at_middle, one.tracks
    cells = np.floor(towards * (camera.f_px / GROUP_PX)).astype(np.int64)
    beside = _beside(tracks.u_px, tracks.v_px, (camera.width, camera.height))
    _, group = np.unique(cells @ np.array([1 << 42, 1 << 21, 2]) + beside, return_inverse=True)
    electrons = one.on_axis_e.sum(axis=1)
    count = int(group.max()) + 1

    def sums(weight: Floats) -> Floats:
        return np.bincount(group, weight, count).astype(np.float64)

    light = np.maximum(sums(electrons), np.finfo(float).tiny)
    middle = np.stack([sums(electrons * part) for part in towards.T], axis=1)
    imaged = np.isfinite(tracks.u_px + tracks.v_px)
    arriving = np.where(imaged, electrons * tracks.light, 0)
    seen = sums(arriving)
    u_px, v_px = (
        np.divide(sums(arriving * np.where(imaged, place, 0)), seen, out=np.full(count, np.nan), where=seen > 0)
        for place in (tracks.u_px, tracks.v_px)
    )
    lit = np.flatnonzero(seen > 0)
    relative = seen / light
    return Shining(
        Groups(middle / np.linalg.norm(middle, axis=1, keepdims=True)),
        GroupTracks(u_px, v_px, relative, lit, u_px[lit], v_px[lit], relative[lit]),
        np.stack([sums(channel) for channel in one.on_axis_e.T], axis=1),
    )


def scattered(plan: FramePlan, scene: Any, camera: Any, sky: Any, image: Any, shining: Sequence[Shining]) -> Any:
    """Electrons of stray light in each pixel, TensorXf of the shape of `image`.

    Parameters
    ----------
    plan : FramePlan
    scene : Scene
        Scene whose environment is the diffuse sky.
    camera : Sensor
    sky : TensorXf
        (height, width, planes): electrons from the diffuse sky and the foreground; for a colour sensor either all
        channels or, as one plane, that of each pixel. Only the latter is used.
    image : TensorXf
        Electrons from the sky, the foreground and points of light; used for a monochrome sensor.
    shining : sequence of Shining
        The points, including those around the frame.
    """
    from generator.frame.surround import WALL_AZIMUTHS, hemisphere_light, relative_light, sky_beside, unhidden
    from generator.plugins.filter_array import chosen
    from generator.plugins.integrator import interleaved

    spec = plan.spec
    integrator = scene.integrator()
    colour = spec.sensor.colour
    pattern = None if colour is None else filter_tile(colour.pattern)
    grid = cell_grid(spec.camera, colour is not None)
    _, u, v = cells_outside(grid)
    lights = [(one.emitter, _mean_over_time(one)) for one in shining]
    walls = WALL_AZIMUTHS if spec.camera.rings else 0
    surround = Surround(
        sky_beside(scene, integrator, camera, u, v), *hemisphere_light(scene, integrator, camera, lights, walls)
    )
    free = [unhidden(scene, integrator, one.emitter) for one in shining]

    def sources(beyond: tuple[int, int] | None) -> list[PointSources]:
        return [_sources(one, part, beyond) for one, part in zip(shining, free, strict=True)]

    # A mosaic samples stars too coarsely for sums over cells.
    others = sources((spec.camera.width, spec.camera.height) if pattern is None else None)
    planes = stray_light(image if pattern is None else sky, others, surround, grid, spec.camera, pattern)
    if spec.camera.all_ghosts:
        more = ghosts(sky, sources(None), surround, grid, spec.camera, pattern)
        planes = [light + ghost for light, ghost in zip(planes, more, strict=True)]
    if spec.camera.scratch_kinds:
        random = random_stream(plan.scenario.seed, "unit.scratches", 0)
        lit = [(one.u_px, one.v_px, one.electrons) for one in sources(None)]
        for kind in spec.camera.scratch_kinds if lit else ():
            streaks = scratch_light(kind, lit, spec.camera, random, lambda u, v: lens_light(camera, u, v))
            planes = [light + type(light)(streak.ravel()) for light, streak in zip(planes, streaks, strict=True)]
    if spec.camera.haze:
        even = spec.camera.haze * relative_light(camera)
        planes = [
            light + type(light)(even * float(mean)) for light, mean in zip(planes, surround.hemisphere, strict=True)
        ]
    height, width, count = image.shape
    if pattern is not None and count == 1:
        planes = [chosen(pattern, planes, width, height)]
    return type(image)(interleaved(planes), (height, width, count))


def lens_light(camera: Any, u: Floats, v: Floats) -> Floats:
    """Fraction of the light on the axis that a Sensor's lens passes at places, px; 0 where it images nothing, (n,) array."""
    import mitsuba as mi

    across, down = mi.Float(u), mi.Float(v)
    *_, cosine, valid = camera.lens.unproject(across, down)
    light = np.array(camera.relative_light(across, down, cosine), dtype=np.float64)
    return np.where(np.array(valid), np.nan_to_num(light), 0.0)


def dust_of(plan: FramePlan) -> Singles:
    """Fraction of the light that passes the dust of a camera, (height, width, 1) array."""
    camera = plan.spec.camera
    assert camera.dust is not None
    random = random_stream(plan.scenario.seed, "unit.dust", 0)
    return dust_shadows(camera.dust, camera.width, camera.height, random)[:, :, None]


def _mean_over_time(one: Shining) -> Floats:
    share = one.emitter.light_share
    return one.on_axis_e if share is None else one.on_axis_e * share[:, None]


def _beside(u: Floats, v: Floats, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether positions, px, are outside a frame of a width and height."""
    width, height = size
    return np.asarray((np.abs(u - (width - 1) / 2) > width / 2) | (np.abs(v - (height - 1) / 2) > height / 2))


def _sources(one: Shining, free: Floats, beyond: tuple[int, int] | None) -> PointSources:
    """Return points near the frame at each of their moments, and others, as far as they are `free`, at mid-exposure.

    `beyond` limits them to those outside a frame of this width and height.
    """
    tracks = one.tracks
    far = np.ones(len(tracks.u_px), dtype=bool)
    far[tracks.star] = False
    far &= np.isfinite(tracks.u_px) & (tracks.light > 0)
    near = np.ones(len(tracks.star), dtype=bool)
    if beyond is not None:
        near = _beside(tracks.u, tracks.v, beyond)
    star = np.concatenate([tracks.star[near], np.flatnonzero(far)])
    light = np.concatenate([tracks.weight[near], (tracks.light * free)[far]])
    return PointSources(
        np.concatenate([tracks.u[near], tracks.u_px[far]]),
        np.concatenate([tracks.v[near], tracks.v_px[far]]),
        one.on_axis_e[star] * light[:, None],
    )
