"""State crosses frames only through a History that the caller passes."""

from dataclasses import replace

import numpy as np

import celnav
from celnav.sky.catalog import load_catalog

CAMERA = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
R_CAM = np.diag([-1.0, -1.0, 1.0])
UTC_OK = "2015-06-01T00:00:00Z"


def frame(v_max=4.0):
    """Brightest stars in a frame at 40 N, 10 E; by celnav's own model, since only the bookkeeping is looked at."""
    from celnav.sky.astrometry import apparent_enu

    catalog = load_catalog()
    stars = catalog.take(np.flatnonzero(catalog.v_mag <= v_max))
    uv = CAMERA.project(apparent_enu(stars, UTC_OK, 40.0, 10.0) @ R_CAM.T)
    seen = np.isfinite(uv).all(axis=1)
    seen[seen] = CAMERA.in_frame(uv[seen])
    return uv[seen], 10 ** (-0.4 * stars.v_mag[seen])


def solve(history, solver="thesis-adaptive"):
    uv, flux = frame()
    return celnav.solve(uv, CAMERA, UTC_OK, R_CAM, solver, history, flux=flux)


def test_without_a_history_frames_stand_alone():
    first, second = solve(None), solve(None)
    assert first.ok
    assert (first.lat_deg, first.confidence, first.details) == (second.lat_deg, second.confidence, second.details)


def test_a_history_is_read_and_extended():
    history = celnav.History()
    chosen = solve(history).details["catalogue_limit_mag"]
    assert history.entries == [(round(chosen * 10), solve(None).confidence)]
    # An older consensus on a catalogue that the density does not suggest takes over: fast mode looks at no other.
    stale = celnav.History(entries=[(36, 0.9)] * 6)
    assert solve(stale).details["catalogue_limit_mag"] == 3.6
    assert chosen != 3.6
    # Below four fifths of agreement the catalogue is only probed beside the others.
    split = celnav.History(entries=[(20, 0.9)] * 4 + [(45, 0.9)] * 3)
    assert solve(split).details["catalogue_limit_mag"] == chosen


def test_the_baseline_ignores_the_history():
    stale = celnav.History(entries=[(30, 0.9)] * 6)
    assert solve(stale, "thesis-baseline").details["catalogue_limit_mag"] == 4.0


def test_every_choice_can_be_changed():
    one = celnav.ddr_solver(replace(celnav.THESIS_ADAPTIVE, stars_in_fix="one"))
    votes_only = celnav.ddr_solver(replace(celnav.THESIS_ADAPTIVE, bearings="ignored"))
    for solver in (one, votes_only):
        fix = solve(None, solver)
        assert len(fix.matches) == 1
        assert fix.solver == "custom"


def test_polar_rejection():
    """Near the pole the middle of the frame is polar: with the rule, no reference star has |dec| > 75."""
    from celnav.sky.astrometry import apparent_enu

    catalog = load_catalog()
    stars = catalog.take(np.flatnonzero(catalog.v_mag <= 4.2))
    uv = CAMERA.project(apparent_enu(stars, UTC_OK, 84.0, 10.0) @ R_CAM.T)
    seen = np.isfinite(uv).all(axis=1)
    seen[seen] = CAMERA.in_frame(uv[seen])
    uv, flux, dec = uv[seen], 10 ** (-0.4 * stars.v_mag[seen]), np.degrees(stars.dec_rad[seen])
    found = {}
    for limit in (None, 75.0):
        solver = celnav.ddr_solver(replace(celnav.THESIS_ADAPTIVE, reject_polar_deg=limit))
        fix = celnav.solve(uv, CAMERA, UTC_OK, R_CAM, solver, flux=flux)
        assert fix.ok
        found[limit] = dec[fix.details["reference_detection"]]
    assert found[None] > 75
    assert found[75.0] <= 75
