"""Values of the camera presets that are skybench's own: typical of such parts, but without a source."""

from __future__ import annotations

_CMOS = ("sensor.rolling_shutter", "sensor.black_level_dn", "sensor.dark_current_e_s", "sensor.prnu", "sensor.dsnu_e")
OWN_VALUES: dict[str, tuple[str, ...]] = {
    "thesis-720p": ("camera.aperture_mm",),
    "imx477-6mm": (
        "camera.k", "camera.vignetting", "camera.psf", "sensor.dark_current_e_s", "sensor.prnu", "sensor.dsnu_e",
    ),
    "imx290-8mm": ("camera.focal_length_mm", "camera.aperture_mm", *_CMOS),
    "imx462-fisheye": ("camera.focal_length_mm", "camera.aperture_mm", *_CMOS),
    "superstar-allsky": (
        "camera.veiling_glare", "sensor.quantum_efficiency", "sensor.dark_current_e_s",
    ),
    "gmn-imx291": ("camera.pupil", "sensor.bits", "sensor.dark_current_e_s"),
    "machine-vision-mono": (
        "camera.focal_length_mm", "camera.aperture_mm", "sensor.quantum_efficiency", "sensor.black_level_dn",
        "sensor.dark_current_e_s",
    ),
    "pixel-8-main": (
        "camera.k", "camera.vignetting", "camera.psf", "sensor.rolling_shutter", "sensor.full_well_e", "sensor.read_noise_e",
        "sensor.gain_e_per_dn", "sensor.black_level_dn", "sensor.dark_current_e_s", "sensor.prnu", "sensor.dsnu_e",
    ),
    "altair-star-tracker": (
        "camera.psf", "camera.bloom", "sensor.quantum_efficiency", "sensor.full_well_e", "sensor.read_noise_e",
        "sensor.gain_e_per_dn", "sensor.black_level_dn", "sensor.bits", "sensor.dark_current_e_s", "sensor.temperature_c",
        "sensor.dark_reference_c", "sensor.prnu", "sensor.dsnu_e",
    ),
    "uav-pregius-8mm": (
        "camera.focal_length_mm", "camera.aperture_mm", "camera.k", "camera.vignetting", "camera.psf_sigma_px",
        "sensor.quantum_efficiency", "sensor.black_level_dn", "sensor.dark_current_e_s", "sensor.prnu", "sensor.dsnu_e",
    ),
}  # fmt: skip
"""Keys by preset. skybench's defaults, which a preset does not set, are also skybench's own."""


def labelled(name: str) -> str:
    """Return a sentence that lists the preset's own values."""
    return f"skybench's own, of the usual size: {', '.join(OWN_VALUES[name])}, and all defaults."
