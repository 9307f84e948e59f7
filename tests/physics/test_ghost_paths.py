"""Ghosts of lens prescriptions, against rays traced surface by surface by Snell's law on spheres, apart from the matrices."""

import math

import numpy as np
import pytest

from generator.scenario.camera_spec import CameraSpec
from generator.scenario.lens.prescription import PRESCRIPTIONS, Prescription, first_order_ghosts, focused

CAMERA = {"width": 1000, "height": 800, "focal_length_mm": 8.0, "pixel_pitch_um": 4.0, "aperture_mm": 4.0}


def meets(place: np.ndarray, way: np.ndarray, vertex: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Where a ray in the plane (z, y) meets a surface near its vertex, and the normal there."""
    if math.isinf(radius):
        return place + way * (vertex - place[0]) / way[0], np.array([1.0, 0.0])
    centre = np.array([vertex + radius, 0.0])
    off = place - centre
    along = off @ way
    root = math.sqrt(along**2 - off @ off + radius**2)
    hits = [place + way * step for step in (-along - root, -along + root)]
    hit = min(hits, key=lambda each: abs(each[0] - vertex))
    return hit, (hit - centre) / radius


def traced(lens: Prescription, height: float, slope: float, mirrors: tuple[int, int] | None) -> float:
    """Height on the sensor of a ray through the front vertex' plane, by way of two reflections or none."""
    lens, _ = focused(lens)
    vertex = np.concatenate([[0.0], np.cumsum([surface.thickness_mm for surface in lens.surfaces])])
    n = [1.0, *(surface.index for surface in lens.surfaces)]
    radius = [*(surface.radius_mm for surface in lens.surfaces), math.inf]
    count = len(lens.surfaces)
    legs = [(range(count), 1)]
    if mirrors is not None:
        front, back = mirrors
        legs = [(range(back), 1), (range(back - 1, front, -1), -1), (range(front + 1, count), 1)]
    place = np.array([-1e-9, height])
    way = np.array([1.0, slope]) / math.hypot(1, slope)
    for number, (leg, towards) in enumerate(legs):
        for each in leg:
            before, after = (n[each], n[each + 1]) if towards > 0 else (n[each + 1], n[each])
            place, normal = meets(place, way, vertex[each], radius[each])
            normal = normal * math.copysign(1, normal @ way)
            cosine = normal @ way
            ratio = before / after
            way = ratio * way + (math.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine) * normal
        if number < len(legs) - 1:
            place, normal = meets(place, way, vertex[mirrors[1 - number]], radius[mirrors[1 - number]])
            way = way - 2 * (way @ normal) * normal
    place = place + way * (vertex[count] - place[0]) / way[0]
    return float(place[1])


def test_focal_lengths_are_the_published_ones() -> None:
    """The double Gauss: 100 mm, its focus 55.742 mm behind the last surface; the fisheye: 10.5 mm by its name."""
    gauss, focal = focused(PRESCRIPTIONS["double-gauss"])
    assert focal == pytest.approx(100, rel=0.002)
    assert gauss.surfaces[-1].thickness_mm == pytest.approx(55.742, abs=0.3)
    assert focused(PRESCRIPTIONS["fisheye"])[1] == pytest.approx(10.5, rel=0.07)


@pytest.mark.parametrize("name", PRESCRIPTIONS)
def test_ghosts_are_where_traced_rays_fall(name) -> None:
    """The shift of every ghost by nearly axial rays, to 1e-3; its size is at most that of the whole pupil's."""
    lens = PRESCRIPTIONS[name]
    _, focal = focused(lens)
    found = first_order_ghosts(lens, None, 0.1)
    assert len(found) > 50
    tiny = 1e-6
    # The direct ray: the image of a slope is the focal length times it, whatever the height.
    assert traced(lens, 1e-4, tiny, None) == pytest.approx(focal * tiny, rel=1e-3)
    pupil = focal / lens.f_number
    for ghost in found:
        mirrors = (ghost.front, ghost.back)
        per_height = traced(lens, 1e-4, 0.0, mirrors) / 1e-4
        per_slope = traced(lens, 0.0, tiny, mirrors) / tiny
        # Along the chief ray, which meets the front at a height that makes it cross the axis in the stop.
        chief = chief_height(lens, tiny) / tiny
        assert ghost.shift_mm == pytest.approx(per_slope + per_height * chief, rel=1e-3, abs=1e-3 * focal)
        assert ghost.diameter_mm <= abs(per_height) * pupil * (1 + 1e-4)


def chief_height(lens: Prescription, slope: float) -> float:
    """Height in the front vertex' plane at which light of a slope crosses the axis in the stop, from two traced rays."""
    until = Prescription(lens.title, lens.source, lens.surfaces[: lens.stop], 0, lens.f_number)
    vertex = sum(surface.thickness_mm for surface in until.surfaces)

    def at_stop(height: float, slope: float) -> float:
        place, way = np.array([-1e-9, height]), np.array([1.0, slope])
        way /= np.linalg.norm(way)
        at, before = 0.0, 1.0
        for surface in until.surfaces:
            place, normal = meets(place, way, at, surface.radius_mm)
            normal = normal * math.copysign(1, normal @ way)
            ratio, cosine = before / surface.index, normal @ way
            way = ratio * way + (math.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine) * normal
            at, before = at + surface.thickness_mm, surface.index
        return float(place[1] + way[1] * (vertex - place[0]) / way[0])

    return -at_stop(0.0, slope) / (at_stop(1e-6, 0.0) / 1e-6)


def test_a_camera_takes_the_brightest_ghosts_of_a_design() -> None:
    """Scaled to its own focal length and pupil; a coating ten times better makes them a hundred times fainter."""
    camera = CameraSpec.model_validate(CAMERA | {"ghost_lens": {"design": "double-gauss", "brightest": 5}})
    ghosts = camera.all_ghosts
    assert len(ghosts) == 5
    assert camera.direct_share == pytest.approx(
        1 - camera.bloom.share - camera.veiling_glare - sum(ghost.share for ghost in ghosts)
    )
    lens = PRESCRIPTIONS["double-gauss"]
    _, focal = focused(lens)
    shifts = {round(ghost.shift_mm / focal, 6) for ghost in first_order_ghosts(lens, 0.005, 0.0)}
    assert {round(ghost.magnification, 6) for ghost in ghosts} <= shifts
    better = CameraSpec.model_validate(
        CAMERA | {"ghost_lens": {"design": "double-gauss", "brightest": 5, "coating_reflectance": 0.0005}}
    )
    assert sum(ghost.share for ghost in better.all_ghosts) < 0.2 * sum(ghost.share for ghost in ghosts)
    assert CameraSpec.model_validate(CAMERA).all_ghosts == ()
