"""UTC and Earth orientation."""

import astropy_iers_data
import numpy as np
import pytest
from astropy.utils import iers

from generator.errors import DataFileError, TimeRangeError
from generator.places.times import Instant, earth_orientation, finals2000a


def test_round_trip_and_arithmetic_over_a_leap_second() -> None:
    before = Instant.parse("2016-12-31T23:59:59.5Z")
    assert before.plus(1.0).isoformat() == "2016-12-31T23:59:60.500000Z"
    assert before.plus(2.0).isoformat() == "2017-01-01T00:00:00.500000Z"
    assert Instant.parse("2020-02-29T12:34:56.789Z").isoformat() == "2020-02-29T12:34:56.789000Z"


def test_days_of_86400_s_run_on_through_a_day_with_a_leap_second() -> None:
    """Noon to noon across 2016-12-31T23:59:60 are 86,401 s, and a plain Julian date counts each as it does others."""
    noon = Instant.parse("2016-12-31T12:00:00Z")
    assert sum(noon.plain_jd()) == pytest.approx(2457754.0, abs=1e-9)
    for second in (0.0, 1.0, 21_600.0, 43_199.0):
        first, rest = noon.plus(second).plain_jd()
        assert (first - 2457754.0 + rest) * 86400 == pytest.approx(second, abs=2e-4)
    assert sum(Instant.parse("2017-01-01T12:00:00Z").plain_jd()) == pytest.approx(2457755.0, abs=1e-9)


@pytest.mark.parametrize(
    "text",
    ["2020-01-01T00:00:00", "2020-01-01T00:00:00+01:00", "2020-13-01T00:00:00Z", "2021-02-29T00:00:00Z",
     "2020-01-01T24:00:00Z", "2020-01-01T12:60:00Z", "2020-01-01T12:00:60Z", "now", "", "2020-01-01"],
)  # fmt: skip
def test_other_texts_are_refused(text) -> None:
    with pytest.raises(ValueError, match=r"2020|2021|is not a UTC time"):
        Instant.parse(text)


def test_against_astropy_s_reading_of_the_same_table() -> None:
    """Across the leap second of 2017 too; astropy takes Bulletin B's final values, which differ by 0.2 mas in the pole."""
    table = iers.IERS_A.open()
    for text in ("1999-05-05T06:00:00Z", "2016-12-31T18:00:00Z", "2017-01-01T06:00:00Z", "2024-11-03T17:20:00Z"):
        instant = Instant.parse(text)
        ours = earth_orientation(instant)
        ut1_utc = table.ut1_utc(instant.utc1, instant.utc2).to_value("s")
        x, y = (value.to_value("arcsec") for value in table.pm_xy(instant.utc1, instant.utc2))
        assert ours.ut1_utc_s == pytest.approx(ut1_utc, abs=5e-5)
        np.testing.assert_allclose([ours.polar_motion_x_arcsec, ours.polar_motion_y_arcsec], [x, y], atol=3e-4)


def test_every_row_is_astropy_s() -> None:
    table = iers.IERS_A.read(iers.IERS_A_FILE)
    columns = (("MJD", "d"), ("PM_x_A", "arcsec"), ("PM_y_A", "arcsec"), ("UT1_UTC_A", "s"))
    expected = np.stack([np.asarray(table[name].to_value(unit)) for name, unit in columns], axis=1)
    assert len(expected) > 19_000
    np.testing.assert_array_equal(finals2000a(), expected)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("73 1 2 no table".ljust(58) + "x\n", r"finals2000A\.all: not an Earth orientation table.*reinstall"),
        ("73 1 2\n", r"finals2000A\.all: holds no UT1-UTC; reinstall"),
    ],
)
def test_a_damaged_table_is_named(tmp_path, monkeypatch, text, message) -> None:
    (tmp_path / "finals2000A.all").write_text(text * 3)
    monkeypatch.setattr(astropy_iers_data, "IERS_A_FILE", str(tmp_path / "finals2000A.all"))
    with pytest.raises(DataFileError, match=message):
        finals2000a.__wrapped__()


@pytest.mark.parametrize("days", [-1.0, 1.0])
def test_outside_the_table_is_an_error_with_a_remedy(days) -> None:
    table = finals2000a()
    edge = table[0, 0] if days < 0 else table[-1, 0]
    with pytest.raises(TimeRangeError, match=r"Earth orientation table.*update astropy-iers-data"):
        earth_orientation(Instant(2400000.5, edge + days))


@pytest.mark.parametrize("text", ["1950-01-01T00:00:00Z", "2099-01-01T00:00:00Z"])
def test_years_without_known_leap_seconds_are_refused(text) -> None:
    with pytest.raises(ValueError, match="leap seconds are not known"):
        Instant.parse(text)
