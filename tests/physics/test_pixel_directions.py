"""Directions of pixels lead back to the catalogue: the inverse of the way that the truth's stars have come."""

import numpy as np
import pytest
from small_scenes import small_scenario

from generator.export.pixel_directions import pixel_directions
from generator.frame.record import frame_record
from generator.frame.render import render_frame


@pytest.mark.parametrize(
    ("overrides", "tolerance_px"),
    [
        ({"camera__hfov_deg": 120, "attitude": {"azimuth_deg": 40, "altitude_deg": 30, "roll_deg": 10}}, 1e-3),
        (
            {
                "camera__hfov_deg": 40,
                "motion": {"rate_deg_s": [2, 1, 0.5]},
                "sensor": {"rolling_shutter": {"line_time_us": 500, "direction": "up"}},
            },
            # The Earth's turn while rows are read is neglected: 15 arcsec a second.
            0.02,
        ),
    ],
)
def test_places_of_the_truth_lead_back_to_the_catalogue(overrides, tolerance_px) -> None:
    """Down to the horizon, and of a turning camera with a rolling shutter."""
    frame = render_frame(small_scenario(**overrides, stars={"limiting_magnitude": 6.0}), 0)
    record = frame_record(frame.plan, frame.expected, frame.stars)
    stars = frame.stars.to_pandas()
    stars = stars[(stars["kind"] == "star") & (stars["fraction_in_frame"] > 0.9)]
    assert len(stars) > 100
    icrs, altitude_deg = pixel_directions(record, stars["u_px"].to_numpy(), stars["v_px"].to_numpy())
    ra, dec = np.radians(stars["ra_deg"].to_numpy()), np.radians(stars["dec_deg"].to_numpy())
    truth = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
    apart_px = np.linalg.norm(icrs - truth, axis=1) * record["camera"]["f_px"]
    # Parallax, which places of the catalogue do not have, is below an arcsecond.
    assert apart_px.max() < tolerance_px
    np.testing.assert_allclose(altitude_deg, stars["altitude_deg"], atol=2e-3)
