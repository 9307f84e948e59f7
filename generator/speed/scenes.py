"""The scenarios that are timed."""

from __future__ import annotations

from dataclasses import dataclass

from generator.scenario.file import Scenario, parse_scenario

_SET = """
name: speed
seed: 1
frames: {frames}
site: {{latitude_deg: {{uniform: [-60, 60]}}, longitude_deg: {{uniform: [-180, 180]}}}}
time: {{utc_start: {{utc: [2000-01-01T00:00:00Z, 2025-12-31T00:00:00Z], sun_below_deg: -6}}, exposure_s: 0.5}}
attitude: zenith-north-up
camera: {camera}
sensor: {sensor}
motion: {motion}
sky: {{bortle: 4}}
stars: {{limiting_magnitude: {limiting_magnitude}}}
"""
_MOONLIT = """
name: speed
site: {{latitude_deg: 52.0, longitude_deg: 4.36}}
time: {{utc_start: 2020-01-08T21:{minute:02d}:00Z, exposure_s: 0.5}}
camera: {camera}
sky: {sky}
stars: {{limiting_magnitude: 6.5}}
"""
_EVERYTHING = """
name: speed
seed: 1
frames: {frames}
site: {{latitude_deg: {{uniform: [-60, 60]}}, longitude_deg: {{uniform: [-180, 180]}}}}
time: {{utc_start: {{utc: [2000-01-01T00:00:00Z, 2025-12-31T00:00:00Z], sun_below_deg: -6}}, exposure_s: 0.5}}
attitude: {{azimuth_deg: {{uniform: [0, 360]}}, altitude_deg: 40}}
camera: {camera}
sensor:
  colour: {{pattern: RGGB}}
  rolling_shutter: {{line_time_us: 30}}
  prnu: 0.01
  dsnu_e: 1.0
  dsnu_column_e: 0.3
  hot_pixel_fraction: 0.0002
  dead_pixel_fraction: 0.0001
  blinking_pixels: {{fraction: 0.0001, amplitude_e_s: 400}}
  telegraph: {{fraction: 0.01, amplitude_e: 8}}
  row_noise_e: 0.5
  column_noise_e: 0.5
  interference: [{{cycles_per_column: 0.07, cycles_per_row: 0.3, amplitude_e: 1.5}}]
  blooming: true
  cosmic_rays: {{rate_s: 3}}
motion: {{rate_deg_s: [0.3, 0.8, -0.5], samples: 32}}
foreground:
  landscape: {{skyline: [hills, forest, roofs, masts]}}
  lamps: [{{azimuth_deg: 63, altitude_deg: 4, distance_m: 60, intensity_cd: 60, downward_cd: 900, kind: HPS}}]
sky: {{bortle: 4, clouds: {{kind: altocumulus, wind_m_s: 15}}}}
stars: {{limiting_magnitude: {limiting_magnitude}, scintillation: true}}
"""
_CAMERA = "width: {width}, height: {height}, hfov_deg: 120, aperture_mm: 4"
_LENS = (
    "pixel_pitch_um: 4.0, psf: {diffraction: {f_number: 2.0, coma_waves: 0.2, astigmatism_waves: 0.2}, "
    "gaussian_sigma_px: 0.5, support_px: 8}"
)
PLAIN_SKY = "{zenith_mag_arcsec2: 20.0, components: [airglow, skyglow]}"
FULL_SKY = "{bortle: 5}"
WHOLE_CATALOGUE_MAG = 15.0


@dataclass(frozen=True)
class FrameSize:
    """Size of the timed frames, and limiting magnitude of their stars."""

    width: int = 1080
    height: int = 720
    limiting_magnitude: float = WHOLE_CATALOGUE_MAG

    @property
    def camera(self) -> str:
        """The plain camera's keys."""
        return _CAMERA.format(width=self.width, height=self.height)


def data_set(size: FrameSize, frames: int, full_camera: bool = False) -> Scenario:
    """A set of frames at random times and places: all components of the sky, all stars, noise.

    The full camera has a Bayer filter array, a rolling shutter, an attitude of 32 samples, and a diffraction pattern with
    coma and astigmatism that grow off axis.
    """
    lens = ", " + _LENS if full_camera else ""
    return parse_scenario(
        _SET.format(
            frames=frames,
            camera="{" + size.camera + lens + "}",
            sensor="{colour: {pattern: RGGB}, rolling_shutter: {line_time_us: 30}}" if full_camera else "{}",
            motion="{rate_deg_s: [0.3, 0.8, -0.5], samples: 32}" if full_camera else "{}",
            limiting_magnitude=size.limiting_magnitude,
        ),
        "speed",
    )


def everything(size: FrameSize, frames: int) -> Scenario:
    """A set of frames with everything at once, at random times, places and azimuths.

    They have the cloud of a different day in each frame, a skyline with lamps up to the frame's centre, the full camera
    of :func:`data_set`, every effect of the sensor, motion during the exposure, and stray light, which is on in all sets.
    """
    return parse_scenario(
        _EVERYTHING.format(
            frames=frames,
            camera="{" + size.camera + ", " + _LENS + "}",
            limiting_magnitude=size.limiting_magnitude,
        ),
        "speed",
    )


def moonlit(size: FrameSize, sky: str, minute: int) -> Scenario:
    """A frame under a high Moon, at a different minute each time so that nothing of the sky is cached."""
    return parse_scenario(_MOONLIT.format(minute=minute % 60, camera="{" + size.camera + "}", sky=sky), "speed")
