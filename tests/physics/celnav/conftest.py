import importlib.util
import sys
from pathlib import Path

import pytest

from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc


@pytest.fixture(scope="session")
def sky():
    spec = importlib.util.spec_from_file_location("independent_sky", Path(__file__).with_name("independent_sky.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def frames(sky):
    """Frames at random sites and dates, all stars to magnitude 6.5."""
    return [
        sky.make_frame(utc, lat, lon, 6.5, earth_orientation(parse_utc(utc)))
        for utc, lat, lon in sky.sites(30, seed=11)
    ]
