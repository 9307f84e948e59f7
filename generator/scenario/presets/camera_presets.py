"""Cameras by name: ``camera: {preset: imx477-6mm}`` fills in the values of camera and sensor that are not given."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class CameraPreset:
    """A camera by name.

    Attributes
    ----------
    title : str
    source : str
        Source of its values; values without a source are listed in `generator.scenario.presets.own_values`.
    camera, sensor : mapping of str to object
        Values of the scenario's two sections; omitted ones have skybench's defaults.
    """

    title: str
    source: str
    camera: dict[str, Any]
    sensor: dict[str, Any] = field(default_factory=dict)


PRESETS: dict[str, CameraPreset] = {
    "thesis-720p": CameraPreset(
        "The camera of the thesis on DDR star identification: 120 deg across, one rectilinear lens",
        "The projection that the thesis assumes (1080 x 720, 120 deg), and a lens without stray light, as its own; the "
        "sensor is skybench's generic one.",
        camera={
            "model": "pinhole",
            "width": 1080,
            "height": 720,
            "hfov_deg": 120.0,
            "aperture_mm": 4.0,
            "bloom": {"share": 0.0},
            "veiling_glare": 0.0,
        },
        sensor={},
    ),
    "imx477-6mm": CameraPreset(
        "Raspberry Pi High Quality Camera (Sony IMX477, colour) with its 6 mm lens at f/2.8",
        "Raspberry Pi High Quality Camera product brief (4056 x 3040, 1.55 um), and its official 6 mm f/1.2 CS-mount lens, "
        "stopped down to f/2.8; full well 8180 e-, read noise 3.0 e- at gain 1 and 0.47 DN/e- as measured by "
        "strollswithmydog.com for this camera; line time by the camera's Linux driver (imx477.c in raspberrypi/linux: 24,000 "
        "periods of 840 MHz a line in the mode of all pixels, 10 frames/s).",
        camera={
            "model": "brown_conrady",
            "width": 4056,
            "height": 3040,
            "focal_length_mm": 6.0,
            "pixel_pitch_um": 1.55,
            "k": [-0.12, 0.02],
            "aperture_mm": 2.14,
            "vignetting": [-0.25],
            "psf": {
                "diffraction": {"f_number": 2.8, "coma_waves": 0.15, "astigmatism_waves": 0.1},
                "gaussian_sigma_px": 0.5,
            },
        },
        sensor={
            "colour": {"pattern": "BGGR"},
            "rolling_shutter": {"line_time_us": 28.57},
            "full_well_e": 8180.0,
            "read_noise_e": 3.0,
            "gain_e_per_dn": 2.13,
            "black_level_dn": 256,
            "bits": 12,
            "dark_current_e_s": 0.3,
            "prnu": 0.01,
            "dsnu_e": 0.5,
        },
    ),
    "imx290-8mm": CameraPreset(
        "Monochrome camera with a Sony IMX290 and an 8 mm f/1.6 lens",
        "1936 x 1096 pixels of 2.9 um; full well and read noise from ZWO's published curves for the ASI290MM (14.6 ke-, "
        "3.2 e- at gain 0), read from them at second hand.",
        camera={
            "width": 1936,
            "height": 1096,
            "focal_length_mm": 8.0,
            "pixel_pitch_um": 2.9,
            "aperture_mm": 5.0,
        },
        sensor={
            "rolling_shutter": {"line_time_us": 14.8},
            "full_well_e": 14600.0,
            "read_noise_e": 3.2,
            "gain_e_per_dn": 3.6,
            "black_level_dn": 60,
            "bits": 12,
            "dark_current_e_s": 0.3,
            "prnu": 0.006,
            "dsnu_e": 0.4,
        },
    ),
    "imx462-fisheye": CameraPreset(
        "Colour camera with a Sony IMX462 and a 1.8 mm f/2 equidistant fisheye",
        "1936 x 1096 pixels of 2.9 um; full well and read noise from ZWO's published curves for the ASI462MC (11.2 ke-, "
        "2.65 e-), read from them at second hand; wings of the lens as measured on the fisheye of superstar-allsky, at the "
        "same distance in micrometres.",
        camera={
            "model": "equidistant",
            "width": 1936,
            "height": 1096,
            "focal_length_mm": 1.8,
            "pixel_pitch_um": 2.9,
            "aperture_mm": 0.9,
            "bloom": {"share": 0.33, "core_px": 6.4, "slope": 2.4, "reach_px": 1600},
        },
        sensor={
            "colour": {"pattern": "RGGB"},
            "rolling_shutter": {"line_time_us": 14.8},
            "full_well_e": 11200.0,
            "read_noise_e": 2.65,
            "gain_e_per_dn": 2.7,
            "black_level_dn": 60,
            "bits": 12,
            "dark_current_e_s": 0.3,
            "prnu": 0.006,
            "dsnu_e": 0.4,
        },
    ),
    "superstar-allsky": CameraPreset(
        "All-sky camera: Starlight Xpress Superstar (Sony ICX205, monochrome) with a 1.57 mm f/2 fisheye under a dome",
        "Measured on frames of an observatory's camera (Mommert 2020, AJ 159, 178; BSD-3-Clause, github "
        "mommermi/cloudynight): the lens by 632 stars of one frame (0.12 px rms an axis), throughput by stars of V 2.5 to 5, "
        "the point spread by stars of two frames, its fall off the axis by sky and stars of five frames without cloud "
        "together, gain by the noise of clouds (4.1 DN^2 for a DN of light), read noise and hot pixels by the dark "
        "corners, PRNU and DSNU by what single pixels have in common on 21 pairs of nights, wings around stars to 38 px; "
        "ghosts, rings and number and strength of scratches by two frames under a bright Moon. "
        "Quantum efficiency in the shape of interline CCDs of that time, 55 % at most, not from a data sheet of the ICX205.",
        camera={
            "model": "kannala_brandt",
            "width": 1392,
            "height": 1040,
            "f_px": 337.3688,
            "pixel_pitch_um": 4.65,
            "cx_px": 709.6952,
            "cy_px": 489.2991,
            "k": [-0.01573895, 2.948e-05, -0.00163156],
            "p": [0.00065626, -7.22e-06],
            "image_circle_px": 500.0,
            "aperture_mm": 0.78,
            "transmission": 0.455,
            "vignetting": [-1.6, -0.67, 2.5],
            "psf": {
                "field_gaussian": {
                    "radial_sigma_px": [[0, 0.34], [40, 0.37], [60, 0.4], [80, 0.37]],
                    "tangential_sigma_px": [[0, 0.36], [40, 0.48], [60, 0.6], [80, 0.7]],
                },
                "support_px": 8,
            },
            "bloom": {"share": 0.56, "core_px": 1.2, "slope": 2.5, "reach_px": 1000},
            "veiling_glare": 0.001,
            "ghosts": [
                {"share": 3.6e-4, "magnification": -0.667, "diameter_px": 140.0},
                {"share": 1.8e-4, "magnification": -0.78, "diameter_px": 105.0},
                {"share": 5.0e-5, "magnification": 0.415, "diameter_px": 26.0},
                {"share": 4.6e-5, "magnification": -1.13, "diameter_px": 34.0},
                {"share": 2.0e-5, "magnification": 0.33, "diameter_px": 18.0},
                {"share": 1.5e-5, "magnification": -0.425, "diameter_px": 30.0},
            ],
            "scratches": {"number": 7500},
            "barrel_ring": [
                {"radius_px": 389.0, "width_px": 8.0, "reflectance": 0.0, "far_side": 0.035},
                {"radius_px": 514.0, "width_px": 9.0, "reflectance": 0.009, "near_side": 0.067, "even": 0.037},
                {"radius_px": 617.0, "width_px": 30.0, "reflectance": 0.0, "near_side": 0.17, "even": 0.0078},
            ],
        },
        sensor={
            "quantum_efficiency": [
                [350, 0.1],
                [400, 0.4],
                [450, 0.5],
                [500, 0.55],
                [550, 0.52],
                [600, 0.44],
                [650, 0.35],
                [700, 0.27],
                [750, 0.2],
                [800, 0.14],
                [850, 0.1],
                [900, 0.06],
                [950, 0.03],
                [1000, 0.01],
            ],
            "full_well_e": 15500.0,
            "read_noise_e": 8.5,
            "gain_e_per_dn": 0.245,
            "black_level_dn": 2320,
            "bits": 16,
            "dark_current_e_s": 0.2,
            "prnu": 0.0047,
            "dsnu_e": 1.6,
            "dsnu_column_e": 0.3,
            "hot_pixel_fraction": 8.5e-5,
            "hot_pixel_e_s": 85.0,
        },
    ),
    "gmn-imx291": CameraPreset(
        "Meteor camera of the Global Meteor Network: IP camera with a Sony IMX291, 720p at 25 frames/s, 4 mm f/0.95 lens",
        "Sensor, lens, video and stacks of 256 frames as the network describes them (Vida et al. 2021, MNRAS 506, 5046); "
        "the pitch is that of the sensor's 1920 columns of 2.9 um scaled to 1280. Measured on frames of one camera of the "
        "network: the lens by 2489 stars (0.23 px), gain, vignetting, point spread and wings by the light of 709, black "
        "level, fixed pattern, hot pixels, noise reduction and bit rate by what stacks have in common and by their noise.",
        camera={
            "model": "kannala_brandt",
            "width": 1280,
            "height": 720,
            "f_px": 894.98,
            "pixel_pitch_um": 4.35,
            "cx_px": 625.24,
            "cy_px": 395.93,
            "k": [-0.13292, 0.01059, -0.00898],
            "pupil": "cosine",
            "aperture_mm": 4.2,
            "transmission": 0.72,
            "vignetting": [-0.4],
            "psf": {
                "field_gaussian": {
                    "radial_sigma_px": [[0, 0.45], [11, 0.5], [17, 0.55], [23, 0.6], [29, 0.85], [35, 1.1], [42, 1.2]],
                    "tangential_sigma_px": [[0, 0.45], [29, 0.55], [35, 0.7], [42, 0.75]],
                },
            },
            "bloom": {"share": 0.35, "core_px": 2.5, "slope": 2.4},
        },
        sensor={
            "full_well_e": 135.0,
            "read_noise_e": 1.2,
            "gain_e_per_dn": 0.026,
            "black_level_dn": 80,
            "bits": 12,
            "dark_current_e_s": 2.0,
            "prnu": 0.15,
            "dsnu_e": 0.9,
            "hot_pixel_fraction": 0.0013,
            "hot_pixel_e_s": 170.0,
            "hot_pixel_log_sigma": 0.45,
            "video": {
                "frames_per_s": 25.0,
                "denoise": {"sigma_px": 0.78, "temporal": 0.5},
                "h264": {"bitrate_kbit_s": 3300.0, "keyframe_every": 100},
            },
        },
    ),
    "machine-vision-mono": CameraPreset(
        "Monochrome machine-vision camera of five megapixels with a global shutter and a 12 mm f/2 lens",
        "2448 x 2048 pixels of 3.45 um with figures of the size that EMVA 1288 data sheets of such cameras state (full well "
        "10.5 ke-, read noise 2.4 e-, DSNU 1 e-, PRNU 0.5 %), not of one product. Quantum efficiency by the 70 % at 545 nm "
        "that Basler states for such pixels.",
        camera={
            "width": 2448,
            "height": 2048,
            "focal_length_mm": 12.0,
            "pixel_pitch_um": 3.45,
            "aperture_mm": 6.0,
        },
        sensor={
            "quantum_efficiency": "cmos-mono-front",
            "full_well_e": 10500.0,
            "read_noise_e": 2.4,
            "gain_e_per_dn": 2.6,
            "black_level_dn": 40,
            "bits": 12,
            "dark_current_e_s": 1.0,
            "prnu": 0.005,
            "dsnu_e": 1.0,
        },
    ),
    "pixel-8-main": CameraPreset(
        "Telephone: main camera of a Google Pixel 8 in its usual pictures of 12.5 megapixels",
        "Google's figures of the camera (50 megapixels of 1.2 um in squares of four, f/1.68, 82 deg across the diagonal, 9.8 "
        'x 7.4 mm; DPReview, "Google Pixel 8 and Pixel 8 Pro: Camera deep-dive", 2023): focal length by angle and diagonal. '
        "Full well and read noise are skybench's own for pixels of 2.4 um.",
        camera={
            "model": "brown_conrady",
            "width": 4080,
            "height": 3072,
            "focal_length_mm": 7.05,
            "pixel_pitch_um": 2.4,
            "k": [0.03, -0.02],
            "aperture_mm": 4.2,
            "vignetting": [-0.45],
            "psf": {
                "diffraction": {"f_number": 1.68, "coma_waves": 0.15, "astigmatism_waves": 0.1},
                "gaussian_sigma_px": 0.45,
            },
        },
        sensor={
            "colour": {"pattern": "RGGB"},
            "rolling_shutter": {"line_time_us": 8.0},
            "full_well_e": 24000.0,
            "read_noise_e": 2.5,
            "gain_e_per_dn": 1.5,
            "black_level_dn": 1024,
            "bits": 14,
            "dark_current_e_s": 0.5,
            "prnu": 0.01,
            "dsnu_e": 0.5,
        },
    ),
    "altair-star-tracker": CameraPreset(
        "Star tracker: SSTL Altair HB+, 15.5 x 10.5 deg",
        "SSTL's answers to questions on its star trackers (768 x 512 pixels of 9 um, lens of 25 mm f/0.95 off the shelf, "
        "exposures of 1 s). Full well, read noise and dark current are skybench's own for CCDs of such pixels, cooled.",
        camera={
            "width": 768,
            "height": 512,
            "focal_length_mm": 25.0,
            "pixel_pitch_um": 9.0,
            "aperture_mm": 26.3,
            "psf": {"gaussian_sigma_px": 0.8},
            "bloom": {"share": 0.1, "core_px": 2.0, "slope": 2.4, "reach_px": 400},
        },
        sensor={
            "quantum_efficiency": [
                [350, 0.02],
                [400, 0.2],
                [450, 0.35],
                [500, 0.42],
                [550, 0.48],
                [600, 0.55],
                [650, 0.58],
                [700, 0.58],
                [750, 0.55],
                [800, 0.48],
                [850, 0.38],
                [900, 0.25],
                [950, 0.13],
                [1000, 0.05],
            ],
            "full_well_e": 90000.0,
            "read_noise_e": 20.0,
            "gain_e_per_dn": 22.0,
            "black_level_dn": 100,
            "bits": 12,
            "dark_current_e_s": 20.0,
            "temperature_c": 0.0,
            "dark_reference_c": 0.0,
            "prnu": 0.01,
            "dsnu_e": 5.0,
        },
    ),
    "uav-pregius-8mm": CameraPreset(
        "UAV: monochrome global-shutter camera with Sony's Pregius pixels of 3.45 um and an 8 mm f/1.8 lens",
        "Balluff's technical documentation of BVS CA-SF cameras (pixels of 3.45 um of the Sony IMX267; signal to noise of at "
        "most 40.2 dB and a dynamic range of 71 dB by EMVA 1288), hence a full well of 10.5 ke- and 2.4 e- of noise; "
        "the format, 2448 x 2048, is that of the IMX264. Quantum efficiency by the 70 % at 545 nm that Basler states for "
        "such pixels.",
        camera={
            "model": "brown_conrady",
            "width": 2448,
            "height": 2048,
            "focal_length_mm": 8.0,
            "pixel_pitch_um": 3.45,
            "k": [-0.08, 0.01],
            "aperture_mm": 4.44,
            "vignetting": [-0.3],
            "psf_sigma_px": 0.7,
        },
        sensor={
            "quantum_efficiency": "cmos-mono-front",
            "full_well_e": 10470.0,
            "read_noise_e": 2.4,
            "gain_e_per_dn": 2.6,
            "black_level_dn": 40,
            "bits": 12,
            "dark_current_e_s": 1.0,
            "prnu": 0.005,
            "dsnu_e": 1.0,
        },
    ),
}
_INSTEAD = {"focal_length_mm", "hfov_deg", "f_px"}


def with_preset(tree: object) -> object:
    """Fill a frame's tree of values from the preset that its camera names; values given in the tree take precedence.

    A focal length or field of view given in any form replaces the preset's.

    Raises
    ------
    ValueError
        There is no such preset.
    """
    if not isinstance(tree, dict) or not isinstance(tree.get("camera"), dict) or "preset" not in tree["camera"]:
        return tree
    name = tree["camera"]["preset"]
    if not isinstance(name, str) or name not in PRESETS:
        raise ValueError(f"camera.preset: found {name!r}, expected one of {', '.join(sorted(PRESETS))}")
    filled = dict(tree)
    for part in ("camera", "sensor"):
        preset, given = copy.deepcopy(getattr(PRESETS[name], part)), tree.get(part, {})
        if not isinstance(given, dict):
            continue
        if part == "camera" and _INSTEAD & set(given):
            preset = {key: value for key, value in preset.items() if key not in _INSTEAD}
        filled[part] = preset | given
    return filled
