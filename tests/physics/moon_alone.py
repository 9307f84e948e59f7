"""A scene whose only light is the Moon's disk, for tests of what a lens scatters."""

from typing import Any

from small_scenes import small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import ExpectedFrame

MOON = {
    "time": {"utc_start": "2020-01-09T22:00:00Z", "exposure_s": 0.01},
    "sky": {"components": ["moonlight"]},
    "stars": {"limiting_magnitude": -2.0, "planets": False},
    "atmosphere": {"refraction": False, "extinction": False},
}
"""The Moon, 57 deg high in the south, without air: no light but its disk's."""


def rendered(**values: Any) -> ExpectedFrame:
    return render_expected(plan_frame(small_scenario(**values), 0))
