"""Setup of a study from a scenario: its camera in words, the faults in the requested sizes, and refusals.

Everything that can be refused is refused here, before a frame is rendered.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from benchmark.errors import BenchmarkError
from benchmark.studies.calibration.kinds import KINDS, Kind
from benchmark.studies.calibration.lens import corner_shift_px, field_deg, with_k1
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.file import Scenario

SIZES_OPTION = "--sizes"
LOWEST_ALTITUDE_DEG = 10.0
"""Lowest altitude of the stars that the study uses."""
MOST_LOOKED_AT = 40
"""Number of frames whose attitudes are inspected before the study."""


@dataclass(frozen=True)
class Subject:
    """The camera of a study, in numbers for its page.

    Attributes
    ----------
    camera : CameraSpec
    field_deg : float
        Field across the width.
    tilts_deg : tuple of float
        Smallest and largest angle of the boresight from the zenith.
    is_colour : bool
        Whether the sensor has more than one channel.
    """

    camera: CameraSpec
    field_deg: float
    tilts_deg: tuple[float, float]
    is_colour: bool = False

    @property
    def has_k1(self) -> bool:
        """Whether its lens belongs to a family of models with a first radial coefficient."""
        return with_k1(self.camera.projection, 0.0) is not None

    @property
    def text(self) -> str:
        """The camera in a few words."""
        model = self.camera.model.replace("_", "-").replace("brown-conrady", "Brown-Conrady").replace(
            "kannala-brandt", "Kannala-Brandt"
        )  # fmt: skip
        return f"{model}, {self.camera.width} x {self.camera.height} px, {self.field_deg:.3g} degrees across"

    @property
    def tilt_text(self) -> str:
        """Where it points, in words."""
        low, high = (f"{tilt:.3g}" for tilt in self.tilts_deg)
        if high == "0":
            return "points to the zenith"
        return f"is tilted by {low} degrees" if low == high else f"is tilted by {low} to {high} degrees"


def read_sizes(given: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Read ``FAULT=SIZE,SIZE,...`` options.

    Raises
    ------
    BenchmarkError
        The message names the option and the permitted values.
    """
    found: dict[str, tuple[float, ...]] = {}
    for one in given:
        key, _, words = one.partition("=")
        if key not in KINDS:
            known = ", ".join(f"{fault.key} ({fault.unit})" if fault.unit else fault.key for fault in KINDS.values())
            raise BenchmarkError(f"{SIZES_OPTION} {one}: no such fault; write FAULT=SIZE,SIZE with one of {known}")
        if key in found:
            raise BenchmarkError(f"{SIZES_OPTION} {one}: {key} has sizes already; give all of them in one option")
        try:
            sizes = tuple(sorted({float(word) for word in words.split(",")}))
        except ValueError:
            raise BenchmarkError(f"{SIZES_OPTION} {one}: {words!r} is not a list of numbers such as 0.1,1") from None
        fault = KINDS[key]
        # A fault by tilt starts at the zenith; all others start above zero.
        allowed = [fault.least <= size <= fault.most and (size > 0 or key == "refraction") for size in sizes]
        if not all(allowed):
            unit = f" {fault.unit}" if fault.unit else ""
            start = "0" if key == "refraction" else f"{fault.least:g}" if fault.least else "more than 0"
            raise BenchmarkError(f"{SIZES_OPTION} {one}: sizes must lie between {start} and {fault.most:g}{unit}")
        found[key] = sizes
    return found


def subject_of(scenario: Scenario) -> Subject:
    """Inspect the camera and the attitudes of a scenario.

    Raises
    ------
    BenchmarkError
        The study does not support the scenario; the message names file and key.
    """
    if scenario.steps is not None:
        raise BenchmarkError(
            f"{scenario.source}: sequence: the study takes frames by themselves; remove the section sequence"
        )
    if scenario.axes:
        key = ".".join(scenario.axes[0][0].path)
        raise BenchmarkError(
            f"{scenario.source}: {key}: the study takes no sweeps; give one value, or a distribution such as uniform"
        )
    for draw in scenario.draws:
        if draw.path[0] in ("camera", "sensor"):
            key = ".".join(draw.path)
            raise BenchmarkError(f"{scenario.source}: {key}: the study is of one camera; give a value")
    specs = [scenario.frame(index) for index in range(min(scenario.frame_count, MOST_LOOKED_AT))]
    camera = specs[0].camera
    tilts = [90.0 - spec.attitude.altitude_deg for spec in specs]
    lens = camera.projection
    reach = lens.axis_angle_deg(min(camera.corner_px / lens.f_px, lens.largest_radius))
    worst = max(tilts)
    if worst - reach > 90.0 - LOWEST_ALTITUDE_DEG:
        raise BenchmarkError(
            f"{scenario.source}: attitude.altitude_deg: the camera sees no sky above {LOWEST_ALTITUDE_DEG:g} deg at an "
            f"altitude of {90.0 - worst:g} deg; let it look higher"
        )
    return Subject(camera, field_deg(lens, camera.width), (min(tilts), worst), specs[0].sensor.colour is not None)


def check_gradient(scenario: Scenario, subject: Subject) -> None:
    """Refuse a scenario whose camera cannot be recovered by gradient.

    Raises
    ------
    BenchmarkError
        The message states the alternative, ``--gradient 0``.
    """
    without = "or leave this part out: --gradient 0"
    if not subject.has_k1:
        raise BenchmarkError(
            f"{scenario.source}: camera.model: {subject.camera.model} has no k1 to recover by gradient; take pinhole, "
            f"brown_conrady, equidistant or kannala_brandt, {without}"
        )
    if subject.is_colour:
        raise BenchmarkError(
            f"{scenario.source}: sensor.colour: the recovery by gradient takes one channel; remove it, {without}"
        )


def check_sizes(subject: Subject, sizes: Mapping[str, tuple[float, ...]]) -> None:
    """Refuse sizes of a fault that are impossible for the camera.

    Raises
    ------
    BenchmarkError
    """
    if "k1" in sizes and not subject.has_k1:
        raise BenchmarkError(
            f"{SIZES_OPTION} k1: a lens of model {subject.camera.model} has no k1; leave this option out"
        )


def notes_of(subject: Subject, faults: Sequence[Kind]) -> dict[str, str]:
    """Notes that the page prints under figures of faults, with the numbers of the camera."""
    camera, lens = subject.camera, subject.camera.projection
    corner = camera.corner_px
    notes = {
        "heading": "A solver without a heading cannot be misled by a wrong one. With self-calibration, the stars "
        "constrain the heading less.",
        "refraction": "Symmetric about the zenith; a tilted camera sees more of it on one side.",
        "epoch": "The same hour, years ago: precession and nutation.",
        "projection": "A pinhole of the same focal length at the axis. The wider the field, the more stars drop out of the "
        "fit, and the first order no longer applies.",
    }
    by_key = {fault.key: fault for fault in faults}
    if "k1" in by_key and (bent := with_k1(lens, by_key["k1"].typical)) is not None:
        moved = corner_shift_px(lens, bent, corner)
        notes["k1"] = f"Stars in the corner move by {moved:.2g} px at {by_key['k1'].typical:g}."
    return notes
