"""The card of a task: what it is for, its frames, what solvers receive, its score and its limits, from the task's files."""

from __future__ import annotations

from benchmark.tasks.definition import SPLITS, Task
from generator import __version__
from generator.frame.outlook import field_of_view_deg

LICENCES = {"CC-BY-4.0": "[CC BY 4.0](https://creativecommons.org/licenses/by/4.0/)"}
LIMITS = (
    "The frames are synthetic; each physical model has limits of its own (docs/physics.md of skybench).",
    "Success on one graded quantity says nothing about another; the other properties of the frames are easy on purpose.",
    "Seeds of both splits are public, so a result on `test` relies on the honesty of its author, or on a set without truth.",
)


def card(task: Task) -> str:
    """Markdown of a task's card; its title is a heading of the second level."""
    definition, condition = task.definition, task.definition.condition
    values = [f"{value:g}" for value in condition.values]
    unit = f" {condition.unit}" if condition.unit else ""
    total = definition.frames_per_condition * (1 if definition.told.lengths else len(values))
    splits = "\n".join(
        f"| `{split}` | {total} | {definition.splits[split].seed} | `{task.scenario_of(split).content_sha256[:16]}` |"
        for split in SPLITS
    )
    metric = definition.metric
    rows = {
        "purpose": f"find the {condition.name} at which a solver fails, and compare solvers at each",
        "graded": f"{condition.name}: {', '.join(values)}{unit}; {condition.harder} is harder",
        "frames": f"{definition.frames_per_condition} per condition"
        + (", the same for all conditions" if definition.told.lengths else "")
        + f"; {_camera(task)}",
        "solvers receive": "the image, the camera, the time of mid-exposure, the attitude, pressure and temperature of the "
        + f"air{_told(task)}",
        "score": f"`{metric.name}`: share of frames with a fix within 10 km of the truth; {metric.better} is better; 95 % "
        + f"intervals within ±{definition.half_width_points} points at one condition, clustered by site",
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


def limits() -> str:
    """Markdown list of what holds for all tasks."""
    return "".join(f"- {line}\n" for line in LIMITS)


def _comment(task: Task) -> str:
    """The first lines of the scenario's file, which say in words what is in it."""
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


def _told(task: Task) -> str:
    """What solvers are told wrongly, level by level."""
    told = task.definition.told
    parts = []
    if told.tilt_sigma_deg:
        levels = ", ".join(f"{value:g}" for value in told.tilt_sigma_deg)
        parts.append(
            f"the vertical is wrong by Gaussian errors of {levels} deg about each axis, which solvers are told"
        )
    if told.heading_sigma_deg:
        levels = ", ".join("unknown" if value >= 180 else f"{value:g}" for value in told.heading_sigma_deg)
        parts.append(f"the heading by errors of {levels} deg, which they are told")
    if told.focal_error:
        levels = ", ".join(f"{value:g}" for value in told.focal_error)
        parts.append(
            f"the focal length is wrong by the relative errors {levels} of either sign, which they are not told"
        )
    return "; " + "; ".join(parts) if parts else ", all without error"
