"""Frames of a scenario with one thing changed."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import TaskError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import FrameSet, ungraded
from benchmark.protocol import Observation
from benchmark.studies.independence.perturbations import UNPERTURBED, Perturbation, SuppliedSizes
from generator.frame.exposure.expected import render_expected
from generator.frame.folder import FrameFolder
from generator.frame.object_table import object_table
from generator.frame.plan import FramePlan, plan_frame
from generator.frame.record import star_table
from generator.frame.render import RenderedFrame, write_frame
from generator.places.astrometry import ApparentPlaces
from generator.reading.strict_yaml import strict_text
from generator.scenario.file import Scenario, parse_scenario
from generator.seeds import random_stream, unit_stream
from generator.sensor.detector import expose
from generator.sensor.sunburn import burnt_pixels

F8 = NDArray[np.float64]

SEPARATOR = "__"
"""Separates the key of a set from the id of a frame."""


def perturbed_scenario(scenario: Scenario, perturbation: Perturbation | None, n_frames: int) -> Scenario:
    """The scenario with a number of frames, its own name, and the perturbation's point spread function.

    Raises
    ------
    TaskError
        The scenario has a sequence, a developed picture, a video or a sweep; the study requires single raw frames.
    ScenarioError
        The scenario's camera does not support the point spread function.
    """
    first = scenario.frame(0)
    if (
        scenario.passage(0) is not None
        or scenario.axes
        or first.sensor.develop
        or first.sensor.video
        or first.sensor.hud
    ):
        raise TaskError(
            f"{scenario.source}: the study takes single raw frames; leave out sequences, sweeps and pictures"
        )
    key = UNPERTURBED if perturbation is None else perturbation.frames_key
    tree = {**scenario.template, "camera": dict(scenario.template["camera"])}
    if perturbation is not None and perturbation.psf:
        changed = {**tree["camera"].get("psf", {}), **perturbation.psf}
        tree["camera"]["psf"] = {name: value for name, value in changed.items() if value is not None}
    header = {"name": f"{scenario.name}-{key}".replace(".", "_"), "seed": scenario.seed, "frames": n_frames}
    return parse_scenario(strict_text({**header, **tree}), scenario.source)


def displaced(plan: FramePlan, perturbation: Perturbation) -> FramePlan:
    """The plan with the stars' directions displaced, each star by the same amount at all moments."""
    displace = perturbation.displace
    if displace is None:
        return plan

    def moved(enu: F8) -> F8:
        rng = random_stream(plan.scenario.seed, f"study.{perturbation.frames_key}", plan.index)
        return displace(plan, enu, rng)

    directions = np.stack([moved(plan.directions[:, k]) for k in range(plan.directions.shape[1])], axis=1)
    start, middle, end = (ApparentPlaces(moved(places.enu)) for places in (plan.start, plan.middle, plan.end))
    return dataclasses.replace(plan, directions=directions, start=start, middle=middle, end=end)


def render_perturbed(
    scenario: Scenario,
    perturbation: Perturbation | None,
    n_frames: int,
    folder: Path,
    progress: Callable[[], None] = lambda: None,
) -> None:
    """Render the frames that a folder lacks; without a perturbation they are the generator's own.

    `progress` is called for each frame that is there. All sets have the same sites, instants, attitudes and noise.

    Raises
    ------
    GeneratorError, TaskError
    """
    changed = perturbed_scenario(scenario, perturbation, n_frames)
    place = FrameFolder(folder, changed)
    place.open(overwrite=False)
    missing = place.missing(False, False)
    for _ in range(n_frames - len(missing)):
        progress()
    for index in missing:
        plan = plan_frame(changed, index)
        if perturbation is not None:
            plan = displaced(plan, perturbation)
        frame = _rendered(plan)
        place.add(index, frame.stars, frame.objects, write_frame(folder, frame, exr=False))
        progress()
    place.finish()


def _rendered(plan: FramePlan) -> RenderedFrame:
    expected = render_expected(plan, False, channels=False)
    stars, objects = star_table(plan, expected), object_table(plan, expected)
    seed, index = plan.scenario.seed, plan.index
    sensor = plan.spec.sensor

    def unit(name: str) -> np.random.Generator:
        return unit_stream(seed, sensor.unit, name)

    dn = expose(
        expected.electrons,
        plan.spec.time.exposure_s,
        sensor,
        lambda name: random_stream(seed, name, index),
        unit,
        plan.start_s,
        burnt_pixels(plan.lens, sensor, unit),
    )
    return RenderedFrame(plan, expected, dn, stars, objects)


def joined_sets(sets: Mapping[str, Path], told: Mapping[str, SuppliedSizes | None] = MappingProxyType({})) -> FrameSet:
    """Join all sets into one, for solvers that take long to start; a frame's id names its set.

    Parameters
    ----------
    sets : mapping of str to Path
        Folders by key.
    told : mapping of str to SuppliedSizes
        Standard deviations that the observations of a set state instead of their own, by key.
    """
    datasets = {key: open_dataset(folder) for key, folder in sets.items()}
    first = next(iter(datasets.values()))
    identities = [one.truth_sha256 + one.scenario_sha256 + repr(told.get(key)) for key, one in datasets.items()]
    together = hashlib.sha256("".join(identities).encode())
    frames = [
        dataclasses.replace(
            frame,
            frame_id=f"{key}{SEPARATOR}{frame.frame_id}",
            index=index,
            record_path=record,
            observation=_told(frame.observation, told.get(key)),
        )
        for index, (key, frame, record) in enumerate(
            (key, frame, frame.record_path or frame.image_path.with_suffix(".json"))
            for key, dataset in datasets.items()
            for frame in dataset.frames
        )
    ]
    joined = dataclasses.replace(first, frames=tuple(frames), truth_sha256=together.hexdigest())
    return ungraded(joined, "the frames of a study")


def _told(seen: Observation, sizes: SuppliedSizes | None) -> Observation:
    if sizes is None:
        return seen
    return dataclasses.replace(seen, tilt_sigma_deg=sizes.tilt_sigma_deg, pressure_sigma_hpa=sizes.pressure_sigma_hpa)
