"""The card of a task, from its files: its purpose, its frames, what solvers receive, its score and its limits."""

from __future__ import annotations

import math

from benchmark.instruments import HEADING_UNKNOWN_DEG
from benchmark.tasks.definition import KM_PER_ARCSEC, SPLITS, Task
from generator import __version__
from generator.frame.outlook import field_of_view_deg

_INSTRUMENTS = (
    ("tilt_sigma_deg", "of the vertical about each axis", " deg"),
    ("tilt_bias_sigma_deg", "of a further error of the vertical that is constant in the camera", " deg"),
    ("heading_sigma_deg", "of the heading", " deg"),
    ("utc_sigma_s", "of the time", " s"),
    ("focal_sigma", "of the focal length, relative,", ""),
    ("focal_range", "a further uniform error of the focal length, relative, within ±", ""),
    ("principal_point_sigma_px", "of the principal point", " px"),
    ("distortion_sigma", "of k1, where the lens is given without its distortion,", ""),
    ("pressure_sigma_hpa", "of the pressure", " hPa"),
    ("temperature_sigma_c", "of the temperature", " deg C"),
)
_IMAGES = {"raw": "", "photo": " (the luma of the developed JPEG)"}
LICENCES = {"CC-BY-4.0": "[CC BY 4.0](https://creativecommons.org/licenses/by/4.0/)"}
LIMITS = (
    "The frames are synthetic; each physical model has its own limits (docs/physics.md of skybench).",
    "Success on one graded quantity says nothing about another; the other properties of the frames are those of one "
    "camera and use, easy or not.",
    "Seeds of both splits are public. A result on `test` therefore relies on its author's honesty or on a set without truth.",
)


def card(task: Task) -> str:
    """Markdown of a task's card; its title is a second-level heading."""
    definition, condition = task.definition, task.definition.condition
    values = [f"{value:g}" for value in condition.values]
    unit = f" {condition.unit}" if condition.unit else ""
    total = definition.frames_per_condition * len(values)
    splits = "\n".join(
        f"| `{split}` | {total} | {definition.splits[split].seed} | `{task.scenario_of(split).content_sha256[:16]}` |"
        for split in SPLITS
    )
    metric = definition.metric
    rows = {
        "purpose": f"find the {condition.name} at which a solver fails, and compare solvers at each value",
        "graded": f"{condition.name}: {', '.join(values)}{unit}; {condition.harder} is harder",
        "frames": f"{definition.frames_per_condition} per condition{_sequences(task)}; {_camera(task)}",
        "solvers receive": f"the image{_IMAGES[definition.image]}, the camera, the time of mid-exposure, the attitude, "
        + f"pressure and temperature of the air{_instruments(task)}",
        "score": f"`{metric.name}`: share of frames with a fix within {_limit(task)}; {metric.better} is better; 95 % "
        + f"intervals (Wilson's, of independent frames) within ±{definition.half_width_points} points at one condition; "
        + "those of the pages, clustered by site, are up to 1 point wider",
        "licence of the frames": LICENCES[definition.licence],
        "run": f"`skybench bench run {definition.name} --solver NAME`",
        "cite": f"skybench {__version__}, task {task.label}, SHA-256 {task.sha256}",
    }
    table = "\n".join(f"| {title} | {text} |" for title, text in rows.items())
    return f"""## {task.label}

**{definition.title}.** {_comment(task)}

| | |
|---|---|
{table}

| split | frames | seed | SHA-256 of the scenario |
|---|---|---|---|
{splits}

```yaml
{_recipe(task)}
```
"""


def _sequences(task: Task) -> str:
    length = task.sequence_length
    return f", from as many sequences of {length} frames, which are presented in order" if length > 1 else ""


def limits() -> str:
    """Markdown list of the limitations that apply to all tasks."""
    return "".join(f"- {line}\n" for line in LIMITS)


def _comment(task: Task) -> str:
    """The first lines of the scenario's file, which describe its content."""
    lines = []
    for line in task.scenario_text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines)


def _recipe(task: Task) -> str:
    return "\n".join(line for line in task.scenario_text.splitlines() if not line.startswith("#")).strip()


def _camera(task: Task) -> str:
    spec = task.scenario_of("dev").frame(0)
    camera = spec.camera
    across, down = field_of_view_deg(camera)
    return (
        f"{camera.width} x {camera.height} pixels, {across:.3g} x {down:.3g} deg, {camera.model}, "
        f"aperture {camera.aperture_mm:g} mm, exposure {spec.time.exposure_s:g} s"
    )


def _limit(task: Task) -> str:
    """The limit of success in km, as an angle, and in pixels."""
    limit_km = task.limit_km
    arcsec = limit_km / KM_PER_ARCSEC
    px = arcsec / (math.degrees(math.atan(1.0 / task.scenario_of("dev").frame(0).camera.f_px)) * 3600.0)
    return (
        f"{_rounded(limit_km, 3)} km of the truth (an angle of {_rounded(arcsec, 3)} arcsec, {_rounded(px, 2)} px at the "
        "middle of the image)"
    )


def _rounded(value: float, digits: int) -> str:
    """Format a number with some significant digits, without an exponent."""
    return f"{float(f'{value:.{digits}g}'):.10g}"


def _instruments(task: Task) -> str:
    """The stated uncertainties of what solvers receive."""
    given = [
        f"{words} {_levels(value, unit)}"
        for name, words, unit in _INSTRUMENTS
        if (value := getattr(task.definition.instruments, name)) != 0.0
    ]
    if not given:
        return ", all without errors"
    rest = ". All other values have no error"
    return ". Values have errors with these standard deviations, which solvers receive too: " + "; ".join(given) + rest


def _levels(value: float | tuple[float, ...], unit: str) -> str:
    """Format one value, or one for each condition, with the unit after the last number."""
    levels = value if isinstance(value, tuple) else (value,)
    numbers = [f"{one:g}" for one in levels if one < HEADING_UNKNOWN_DEG]
    words = ["unknown"] * (len(numbers) < len(levels))
    return ", ".join([*numbers[:-1], *(f"{one}{unit}" for one in numbers[-1:]), *words])
