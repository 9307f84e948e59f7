"""The table of flying objects, Moon, cosmic rays and single pixels: the format is in docs/dataset_format.md."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from generator.frame.exposure.readouts import readouts
from generator.frame.landscape import frame_lamps, lamp_v_mag
from generator.frame.plan import FramePlan
from generator.frame.scene import ExpectedFrame
from generator.frame.star_truth import StarTruth
from generator.optics.psf import equivalent_sigma_px
from generator.sensor.charge import ParticleTracks
from generator.sensor.dark import HotPixels
from generator.sensor.detector import cosmic_rays, defect_pixels, matched_filter_snr, streak_area_px
from generator.sensor.sunburn import burnt_pixels
from generator.sky.moon_irradiance import moon_colours

MOON_OBJECT = -1
COSMIC_RAY_OBJECT = -2
HOT_PIXEL_OBJECT = -3
BURNT_PIXEL_OBJECT = -4
MOST_HOT_PIXELS = 1000
"""Most rows per frame and kind; if there are more pixels, those that differ by the most electrons are listed."""
LEAST_HOT_SNR = 5.0
"""Least signal-to-noise ratio of a hot, blinking or burnt pixel that has a row."""
MOST_COSMIC_RAYS = 1000
"""Most rows per frame; if there are more tracks, those with the most electrons are listed. The hardest frames of the task
`clutter` have 120 000."""

OBJECT_COLUMNS: tuple[tuple[str, pa.DataType, str], ...] = (
    ("index", pa.int32(), ""),
    ("frame_id", pa.string(), ""),
    ("object", pa.int32(), ""),
    ("kind", pa.string(), ""),
    ("v_mag", pa.float32(), "mag"),
    ("bv_mag", pa.float32(), "mag"),
    ("centroid_u_px", pa.float64(), "px"),
    ("centroid_v_px", pa.float64(), "px"),
    ("light_u_px", pa.float64(), "px"),
    ("light_v_px", pa.float64(), "px"),
    ("start_u_px", pa.float64(), "px"),
    ("start_v_px", pa.float64(), "px"),
    ("end_u_px", pa.float64(), "px"),
    ("end_v_px", pa.float64(), "px"),
    ("low_u_px", pa.float64(), "px"),
    ("low_v_px", pa.float64(), "px"),
    ("high_u_px", pa.float64(), "px"),
    ("high_v_px", pa.float64(), "px"),
    ("electrons_e", pa.float32(), "e"),
    ("fraction_in_frame", pa.float32(), "1"),
    ("snr", pa.float32(), "1"),
    ("occluded", pa.bool_(), ""),
)
OBJECT_SCHEMA = pa.schema(
    [pa.field(name, kind, nullable=False, metadata={"unit": unit}) for name, kind, unit in OBJECT_COLUMNS],
    metadata={"format": "skybench-objects/1"},
)

Floats = NDArray[np.float64]


def object_table(plan: FramePlan, expected: ExpectedFrame) -> pa.Table:
    """Return the truth of a frame's flying objects, Moon, cosmic rays and single pixels: those in the frame, even if hidden.

    The Moon's row follows the flying objects, with the object number MOON_OBJECT and V above the atmosphere; then come
    the cosmic rays, with the number COSMIC_RAY_OBJECT, hot and blinking pixels, with HOT_PIXEL_OBJECT, and pixels burnt
    by the Sun, with BURNT_PIXEL_OBJECT. All of these have no magnitudes (NaN).
    """
    return pa.concat_tables(
        [
            _lights(plan, expected),
            _particles(plan, expected),
            *_defects(plan, expected),
            _burnt(plan, expected),
        ]
    )


def _lights(plan: FramePlan, expected: ExpectedFrame) -> pa.Table:
    """Rows of flying objects and the Moon."""
    objects, moon = plan.objects, expected.moon
    lamps = frame_lamps(plan)
    after = plan.spec.foreground.first_lamp + np.arange(len(lamps), dtype=np.int32)
    number = np.concatenate([objects.number, after, np.full(len(moon.electrons), MOON_OBJECT)])
    kind = [*objects.kind, *["lamp"] * len(lamps), *["moon"] * len(moon.electrons)]
    lamp_mag = lamp_v_mag(plan, lamps) if lamps else np.zeros(0)
    v_mag = np.concatenate([objects.v_mag, lamp_mag, np.full(len(moon.electrons), plan.sky.moon_v_mag)])
    moon_bv = moon_colours(plan.sky.moon.phase_angle_deg)[0]
    bv_mag = np.concatenate([objects.bv_mag, np.full(len(lamps), np.nan), np.full(len(moon.electrons), moon_bv)])
    truth = StarTruth(
        *(
            np.concatenate([getattr(part, field.name) for part in (expected.objects, expected.lamps, moon)])
            for field in fields(StarTruth)
        )
    )
    rows = np.flatnonzero((truth.fraction_in_frame > 0) | truth.occluded)
    centroid = np.where(np.isfinite(truth.centroid_px), truth.centroid_px, 0.5 * (truth.start_px + truth.end_px))
    camera = plan.spec.camera
    sigma = equivalent_sigma_px(camera)
    across = truth.high_px - truth.low_px
    area = streak_area_px(np.nan_to_num(np.hypot(*across.T)), sigma)
    # The Moon is a disk, so its area is the disk's fraction of its bounding box.
    disk = np.pi / 4 * np.nan_to_num(across.prod(axis=1))
    area = np.where(number == MOON_OBJECT, np.maximum(area, disk), area)
    electrons = truth.electrons
    return _table(
        plan, len(rows),
        {
            "object": number[rows],
            "kind": [kind[row] for row in rows],
            "v_mag": v_mag[rows],
            "bv_mag": bv_mag[rows],
            "electrons_e": electrons[rows],
            "fraction_in_frame": truth.fraction_in_frame[rows],
            "snr": _snr(plan, expected, camera.direct_share * electrons[rows], centroid[rows], area[rows]),
            "occluded": truth.occluded[rows],
        },
        {
            "centroid": centroid[rows],
            "light": np.where(np.isfinite(truth.light_px), truth.light_px, centroid)[rows],
            "start": truth.start_px[rows],
            "end": truth.end_px[rows],
            "low": truth.low_px[rows],
            "high": truth.high_px[rows],
        },
    )  # fmt: skip


def _particles(plan: FramePlan, expected: ExpectedFrame) -> pa.Table:
    """Rows of cosmic rays; the tracks are drawn from the same random streams as those in the image, or in its video."""
    rays = cosmic_rays(plan.spec.sensor)
    if rays is None:
        return OBJECT_SCHEMA.empty_table()
    camera = plan.spec.camera
    tracks = ParticleTracks.together([rays.tracks(camera.width, camera.height, one) for one in readouts(plan)])
    inside, centroid, low, high = _within(tracks, camera.width, camera.height)
    electrons = tracks.electrons_e
    rows = np.flatnonzero(inside > 0)
    brightest = np.argsort(-electrons[rows], kind="stable")[:MOST_COSMIC_RAYS]
    rows = np.sort(rows[brightest])
    area = streak_area_px(tracks.length_px[rows], 0.0)
    count = len(rows)
    return _table(
        plan, count,
        {
            "object": np.full(count, COSMIC_RAY_OBJECT),
            "kind": ["cosmic_ray"] * count,
            "v_mag": np.full(count, np.nan),
            "bv_mag": np.full(count, np.nan),
            "electrons_e": electrons[rows],
            "fraction_in_frame": inside[rows],
            "snr": _snr(plan, expected, electrons[rows], centroid[rows], area),
            "occluded": np.zeros(count, bool),
        },
        {
            "centroid": centroid[rows],
            "light": centroid[rows],
            "start": tracks.start_px[rows],
            "end": tracks.end_px[rows],
            "low": low[rows],
            "high": high[rows],
        },
    )  # fmt: skip


def _defects(plan: FramePlan, expected: ExpectedFrame) -> Iterator[pa.Table]:
    """Rows of hot pixels, then of blinking ones, from the same random streams as in the image."""
    camera, exposures = plan.spec.camera, readouts(plan)
    for defect in defect_pixels(plan.spec.sensor):
        steady = isinstance(defect, HotPixels)
        drawn = [defect.excess_e_s((camera.height, camera.width), one) for one in exposures[: 1 if steady else None]]
        pixels = drawn[0][0]
        excess_e_s = np.stack([excess_e_s for _, excess_e_s in drawn]).mean(axis=0, dtype=np.float64)
        electrons: Floats = excess_e_s * plan.spec.time.exposure_s
        place = _pixel_places(pixels, camera.width)
        snr = _snr(plan, expected, electrons, place, np.ones(len(pixels)))
        kind = "hot_pixel" if steady else "blinking_pixel"
        yield _pixels(plan, HOT_PIXEL_OBJECT, kind, place, electrons, snr)


def _burnt(plan: FramePlan, expected: ExpectedFrame) -> pa.Table:
    """Rows of the pixels burnt by the Sun: the charge that each retains in this frame, as negative electrons."""
    sensor, exposure_s = plan.spec.sensor, plan.spec.time.exposure_s
    exposures = readouts(plan)
    burnt = burnt_pixels(plan.lens, sensor, exposures[0].unit)
    if burnt is None:
        return OBJECT_SCHEMA.empty_table()
    light = expected.electrons.reshape(-1)[burnt.places].astype(np.float64)
    dark = sensor.mean_dark_e_s * exposure_s
    charge = np.minimum((light + dark) / len(exposures), sensor.full_well_e)
    lost = len(exposures) * burnt.held_e(charge.astype(np.float32)).astype(np.float64)
    place = _pixel_places(burnt.places, plan.spec.camera.width)
    # The noise is that of the remaining charge.
    snr = matched_filter_snr(lost, light - lost, 0.0, exposure_s, sensor, np.ones(len(lost)))
    return _pixels(plan, BURNT_PIXEL_OBJECT, "burnt_pixel", place, -lost, snr)


def _pixel_places(pixels: NDArray[np.intp], width: int) -> Floats:
    """Convert flat indices of pixels to places (n, 2)."""
    return np.stack([pixels % width, pixels // width], axis=1).astype(np.float64)


def _pixels(plan: FramePlan, number: int, kind: str, place: Floats, electrons: Floats, snr: Floats) -> pa.Table:
    """Rows of outstanding single pixels: those with the most additional or missing electrons."""
    rows = np.flatnonzero(snr >= LEAST_HOT_SNR)
    rows = np.sort(rows[np.argsort(-np.abs(electrons[rows]), kind="stable")[:MOST_HOT_PIXELS]])
    count = len(rows)
    return _table(
        plan, count,
        {
            "object": np.full(count, number),
            "kind": [kind] * count,
            "v_mag": np.full(count, np.nan),
            "bv_mag": np.full(count, np.nan),
            "electrons_e": electrons[rows],
            "fraction_in_frame": np.ones(count),
            "snr": snr[rows],
            "occluded": np.zeros(count, bool),
        },
        dict.fromkeys(("centroid", "light", "start", "end", "low", "high"), place[rows]),
    )  # fmt: skip


def _within(tracks: ParticleTracks, width: int, height: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Fraction of each straight track on the sensor, the middle of that part, and its least and greatest u and v."""
    start, way = tracks.start_px, tracks.end_px - tracks.start_px
    edges = np.array([[-0.5, -0.5], [width - 0.5, height - 0.5]])
    # A track begins on the sensor, so it leaves it at most once.
    with np.errstate(divide="ignore", invalid="ignore"):
        leaves = np.where(way > 0, (edges[1] - start) / way, np.where(way < 0, (edges[0] - start) / way, np.inf))
    share = np.clip(leaves.min(axis=1), 0, 1)
    last = start + share[:, None] * way
    return share, 0.5 * (start + last), np.minimum(start, last), np.maximum(start, last)


def _snr(plan: FramePlan, expected: ExpectedFrame, electrons: Floats, place_px: Floats, area_px: Floats) -> Floats:
    """Signal-to-noise ratio of sources, with the sky at their centres."""
    camera = plan.spec.camera
    place = np.nan_to_num(place_px)
    column = np.clip(np.rint(place[:, 0]), 0, camera.width - 1).astype(np.intp)
    row = np.clip(np.rint(place[:, 1]), 0, camera.height - 1).astype(np.intp)
    sky = expected.sky_electrons[row, column].astype(np.float64)
    sigma, exposure_s = equivalent_sigma_px(camera), plan.spec.time.exposure_s
    return matched_filter_snr(electrons, sky, sigma, exposure_s, plan.spec.sensor, area_px)


def _table(plan: FramePlan, count: int, columns: dict[str, object], places: dict[str, Floats]) -> pa.Table:
    """Rows of OBJECT_SCHEMA; `places` are (n, 2) arrays."""
    columns = columns | {"index": np.full(count, plan.index), "frame_id": [plan.frame_id] * count}
    columns |= {f"{name}_u_px": place[:, 0] for name, place in places.items()}
    columns |= {f"{name}_v_px": place[:, 1] for name, place in places.items()}
    arrays = [pa.array(columns[field.name], type=field.type, from_pandas=False) for field in OBJECT_SCHEMA]
    return pa.Table.from_arrays(arrays, schema=OBJECT_SCHEMA)
