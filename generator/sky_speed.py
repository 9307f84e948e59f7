"""How much longer a frame takes with the full sky than with a plain one."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass

from generator.dataset_writer import render_frame
from generator.scenario_file import Scenario, parse_scenario

_SCENARIO = """
name: speed
site: {{latitude_deg: 52.0, longitude_deg: 4.36}}
time: {{utc_start: {utc}, exposure_s: 0.5}}
camera: {{width: 1080, height: 720, hfov_deg: 120, aperture_mm: 4}}
sky: {sky}
stars: {{limiting_magnitude: 6.5}}
"""
PLAIN_SKY = "{zenith_mag_arcsec2: 20.0, components: [airglow, skyglow]}"
FULL_SKY = "{bortle: 5}"


@dataclass(frozen=True)
class SkySpeed:
    """Seconds per frame, pair by pair.

    Attributes
    ----------
    plain_s, full_s : tuple of float
    """

    plain_s: tuple[float, ...]
    full_s: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Median over pairs of full over plain."""
        return statistics.median(full / plain for full, plain in zip(self.full_s, self.plain_s, strict=True))

    def summary(self) -> str:
        """One line for people."""
        return (
            f"1080 x 720, {len(self.plain_s)} pairs: plain sky {statistics.median(self.plain_s):.3f} s, full sky with Moon "
            f"{statistics.median(self.full_s):.3f} s a frame; median ratio {self.ratio:.2f}"
        )


def _scenario(sky: str, minute: int) -> Scenario:
    return parse_scenario(_SCENARIO.format(sky=sky, utc=f"2020-01-08T21:{minute:02d}:00Z"), "speed")


def time_skies(pairs: int) -> SkySpeed:
    """Render frames of a moonlit night in turns, each at a new minute so that nothing of the sky is remembered."""
    render_frame(_scenario(PLAIN_SKY, 0), 0)
    render_frame(_scenario(FULL_SKY, 0), 0)
    seconds: dict[str, list[float]] = {PLAIN_SKY: [], FULL_SKY: []}
    for pair in range(pairs):
        for sky in (PLAIN_SKY, FULL_SKY) if pair % 2 else (FULL_SKY, PLAIN_SKY):
            start = time.perf_counter()
            render_frame(_scenario(sky, 1 + pair % 59), 0)
            seconds[sky].append(time.perf_counter() - start)
    return SkySpeed(tuple(seconds[PLAIN_SKY]), tuple(seconds[FULL_SKY]))
