"""How `celnav solve` writes lengths, positions, names and times."""

import time

import numpy as np
import psutil
import pytest

from celnav import Camera, Fix, Reason
from celnav.__main__ import _process_started_s
from celnav.command.answer import degree_decimals, length_text, map_link, match_names, position_texts
from celnav.command.field_limits import field_deg, field_limit


@pytest.mark.parametrize(
    ("metres", "text"),
    [(0, "0 m"), (0.0312, "0.03 m"), (1.84, "1.8 m"), (9.96, "10 m"), (24.4, "24 m"), (187, "190 m"), (994, "990 m"),
     (996, "1.0 km"), (1312, "1.3 km"), (56_200, "56 km"), (1_234_000, "1200 km")],
)  # fmt: skip
def test_lengths_have_two_significant_digits(metres, text) -> None:
    assert length_text(metres) == text


@pytest.mark.parametrize(
    ("sigma_km", "decimals"), [(56, 1), (1.0, 3), (0.02, 4), (0.002, 5), (1e-9, 7), (500, 1), (0, 5)]
)
def test_digits_follow_the_uncertainty(sigma_km, decimals) -> None:
    assert degree_decimals(sigma_km) == decimals


def fix(lat_deg, lon_deg, sigma_km, matches=()):
    pairs = np.array(matches, dtype=np.int64).reshape(-1, 2)
    return Fix(True, Reason.OK, "", lat_deg, lon_deg, np.eye(2) * sigma_km**2, matches=pairs)


def test_a_position_and_its_map() -> None:
    found = fix(-33.868812, -0.0012, 0.5)
    assert position_texts(found) == ("33.869 S", "0.001 W")
    assert map_link(found) == "https://www.openstreetmap.org/?mlat=-33.869&mlon=-0.001#map=15/-33.869/-0.001"


def test_names_of_matches() -> None:
    found = fix(0, 0, 1, [(0, 32349), (1, -1_000_005), (2, 8102), (3, 2)])
    assert match_names(found) == ["Sirius", "Jupiter", "τ Cet", "HIP 2"]


def test_the_field_reaches_to_the_edges_or_to_the_image_circle() -> None:
    assert field_deg(Camera.pinhole(1080, 720, 60.0)) == pytest.approx((60.0, 42.1034), abs=1e-3)
    fisheye = Camera("orthographic", 1000, 800, f_px=300.0)
    assert field_deg(fisheye) == pytest.approx((180.0, 180.0), abs=8.0)  # the last whole pixel before the circle


def test_limits_of_the_field() -> None:
    wide, narrow = Camera.pinhole(1080, 720, 60.0), Camera.pinhole(1080, 720, 4.9)
    assert field_limit(wide, "skybench") == field_limit(wide, "thesis-adaptive") == ""
    assert "narrower than 5 deg" in field_limit(narrow, "skybench")
    assert "V <= 4.5" in field_limit(narrow, "thesis-adaptive")


def test_the_process_began_when_the_system_says() -> None:
    began = _process_started_s() - time.perf_counter() + time.time()
    assert began == pytest.approx(psutil.Process().create_time(), abs=1.1)  # the system's boot time has whole seconds
