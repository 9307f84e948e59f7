"""Summary of a calibration in words: how well it fits, which terms the lens needs, and how the mount moves."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.calibration import CameraCalibration
from celnav.calibrating.mount import USUAL_WANDER_DEG, turns_deg


def verdict(found: CameraCalibration) -> str:
    """Return the most important findings in one sentence."""
    parts = [f"{found.rms_px:.2f} px rms", *_terms(found), *_mount_words(found)]
    if found.pixel_phase:
        most = max(abs(amplitude) for amplitude in found.pixel_phase.amplitude_px)
        parts.append(f"pixel-phase error of {most:.2f} px taken off")
    if found.pattern.rms_px > 0.5 * found.rms_px:
        parts.append(f"the lens leaves a pattern of {found.pattern.rms_px:.2f} px")
    return ", ".join(parts)


def report(found: CameraCalibration) -> str:
    """Return the calibration as a one-page report."""
    camera = found.camera
    lines = [
        ("verdict", verdict(found)),
        ("lens", f"{found.form.words}; {camera.width} x {camera.height} px"),
    ]
    lines += [
        ("", f"{name:10} {_number(value, sigma)}")
        for (name, sigma), value in zip(found.sigmas.items(), found.values.tolist(), strict=True)
    ]
    nights = len({one.night for one in found.attitudes})
    lines += [
        (
            "stars",
            f"{len(found.residuals.uv)} in {len(found.attitudes)} frame(s) of {nights} night(s); {found.rms_px:.3f} px rms "
            f"an axis by weight, {found.plain_rms_px:.3f} px unweighted, {found.median_px:.3f} px median of both axes",
        ),
        (
            "noise",
            f"{found.noise.floor_px:.3f} px floor"
            + (f", {found.noise.factor:.2f} x the centroids' own standard deviations" if found.noise.factor else "")
            + f"; pattern that neighbours share {found.pattern.rms_px:.3f} px",
        ),
        ("", _phase_words(found)),
        ("held out", _choice(found)),
        ("mount", _attitude_words(found)),
        ("", _sigma_words(found)),
    ]
    lines += [("", line) for line in _night_lines(found)]
    lines += [("left out", name) for name in found.left_out]
    written, before = [], ""
    for label, text in lines:
        written.append(f"{label if label != before else '':10}{text}")
        before = label or before
    return "\n".join(written)


def _terms(found: CameraCalibration) -> list[str]:
    """Describe which of the added terms the held-out stars call for."""
    form, names = found.form, []
    for is_there, word in (
        (form.aspect, "unequal focal lengths"), (form.decentring, "decentring"), (form.prism, "thin prism"),
        (form.tilt, "tilt of the sensor"),
    ):  # fmt: skip
        if is_there:
            names.append(word)
    if not names:
        return []
    return [f"{names[0]} significant" if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} significant"]


def _mount_words(found: CameraCalibration) -> list[str]:
    attitudes = found.attitudes
    if len(attitudes) < 2:
        return []
    nights = sorted({one.night for one in attitudes})
    if len(nights) > 1:
        means = [_night_turn(found, night) for night in nights]
        pairs = [(i, j) for i in range(len(nights)) for j in range(i)]
        i, j = max(pairs, key=lambda pair: float(np.linalg.norm(means[pair[0]] - means[pair[1]])))
        moved = float(np.linalg.norm(means[i] - means[j]))
        return [f"mount moved by {moved:.3f} deg between {_date(found, nights[j])} and {_date(found, nights[i])}"]
    if found.one_attitude_per == "night":
        return [
            "mount steady through the night"
            if found.steady
            else "mount moved through the night, which has one attitude"
        ]
    turns = turns_deg(np.stack([one.R_cam for one in attitudes]), found.mount.R_cam)
    hours = (attitudes[-1].utc.mjd - attitudes[0].utc.mjd) * 24
    return [f"mount moved within {float(np.ptp(turns, axis=0).max()):.3f} deg in {abs(hours):.1f} h"]


def _night_turn(found: CameraCalibration, night: int) -> NDArray[np.float64]:
    rotations = np.stack([one.R_cam for one in found.attitudes if one.night == night])
    return np.asarray(turns_deg(rotations, found.mount.R_cam).mean(axis=0))


def _date(found: CameraCalibration, night: int) -> str:
    mjd = min(one.utc.mjd for one in found.attitudes if one.night == night)
    return str(np.datetime64("1858-11-17") + np.timedelta64(math.floor(mjd), "D"))


def _phase_words(found: CameraCalibration) -> str:
    phase = found.pixel_phase
    if not phase:
        return "no pixel-phase error of the centroids found"
    parts = [
        f"{amplitude:+.3f} +- {sigma:.3f} px x sin(2 pi {axis})"
        for axis, amplitude, sigma in zip("uv", phase.amplitude_px, phase.sigma_px, strict=True)
    ]
    return f"pixel-phase error of the centroids {' and '.join(parts)}, taken off"


def _choice(found: CameraCalibration) -> str:
    if not found.judged:
        return "the form was given"
    best = found.judged[0]
    own = next(one for one in found.judged if one.form == found.form)
    plain = [
        one for one in found.judged if not (one.form.decentring or one.form.tilt or one.form.prism or one.form.aspect)
    ]
    words = f"{own.held_out_px:.3f} px with this form"
    if best.form != own.form and best.held_out_px < own.held_out_px:
        words += f", {best.held_out_px:.3f} with {best.form.words} (within one standard error)"
    if plain and plain[0].form not in (own.form, best.form):
        words += f", {plain[0].held_out_px:.3f} with {plain[0].form.words}"
    return f"{words}; {len(found.judged)} forms compared"


def _attitude_words(found: CameraCalibration) -> str:
    R_cam = found.mount.R_cam
    boresight = R_cam[2]
    altitude = math.degrees(math.asin(max(-1.0, min(1.0, float(boresight[2])))))
    azimuth = math.degrees(math.atan2(boresight[0], boresight[1])) % 360
    return f"boresight at azimuth {azimuth:.3f}, altitude {altitude:.3f} deg; one attitude for each {found.one_attitude_per}"


def _sigma_words(found: CameraCalibration) -> str:
    mount = found.mount
    words = (
        f"for another night: sigma {mount.tilt_sigma_deg:.4f} deg of tilt, {mount.heading_sigma_deg:.4f} deg of heading"
    )
    if math.isfinite(mount.wander_tilt_deg):
        return f"{words} (nights scatter by {mount.wander_tilt_deg:.4f} and {mount.wander_heading_deg:.4f} deg)"
    return f"{words} (one night tells nothing of how far the mount wanders: {USUAL_WANDER_DEG} deg is assumed)"


def _night_lines(found: CameraCalibration) -> list[str]:
    """Describe the rotation from the mean of each frame or, if there are many, of each night."""
    attitudes = found.attitudes
    turns = turns_deg(np.stack([one.R_cam for one in attitudes]), found.mount.R_cam)
    lines = []
    for one, turn in zip(attitudes, turns, strict=True):
        at = np.datetime64("1858-11-17T00:00") + np.timedelta64(round(one.utc.mjd * 86400), "s")
        lines.append(
            f"{at}Z turned {turn[0]:+.4f} {turn[1]:+.4f} {turn[2]:+.4f} deg about east, north, up (sigma "
            f"{one.tilt_sigma_deg:.4f}, {one.heading_sigma_deg:.4f}); {one.stars} stars, {one.rms_px:.2f} px, to V "
            f"{one.limiting_mag:.1f}: {one.name}"
        )
    return lines if len(lines) <= 12 else [*lines[:6], f"… {len(lines) - 12} frames …", *lines[-6:]]


def _number(value: float, sigma: float) -> str:
    """Format a value with two digits of its standard deviation."""
    if not math.isfinite(sigma) or sigma <= 0:
        return f"{value:g}"
    decimals = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"
