"""A task gains conditions at its hard end: its results hold, and those of the new conditions alone complete them."""

from __future__ import annotations

import dataclasses
import shutil

import pytest
from unit.benchmark.fake_night import Truth, write_dataset

from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import FrameSet, Grading, ungraded
from benchmark.run import engine
from benchmark.run.confirm import confirm
from benchmark.run.packed import read_packed
from benchmark.run.packing import pack_tree
from benchmark.tasks.appended import earlier_definitions
from benchmark.tasks.definition import load_task
from generator.identity.revision import GENERATOR_REVISION

VALUES = (1.0, 2.0, 3.0, 4.0, 5.0)
SHORT, LONG = "a" * 64, "b" * 64
EARLIER = {SHORT: 3}
LISTING = "night@1/dev.json"


@dataclasses.dataclass(frozen=True)
class Settled(Truth):
    """The truth, with a revision."""

    revision: str = "one"


def part(folder, definition: str, values: tuple[float, ...], condition: float | None = None) -> FrameSet:
    """Frames of a fake task with these conditions, which are its Bortle classes: all of them, or those of one."""
    found = ungraded(open_dataset(folder), str(folder))
    frames = tuple(
        dataclasses.replace(frame, condition=float(frame.conditions.bortle))
        for frame in found.frames
        if frame.conditions.bortle in (values if condition is None else (condition,))
    )
    facts = dataclasses.replace(
        found.facts,
        label="night@1",
        split="dev",
        condition=condition,
        per_condition=2,
        grading=Grading("class", "", values, "higher"),
        definition_sha256=definition,
        scenario_sha256=("1" if definition == SHORT else "2") * 64,
        rendered_with={"skybench": "9.9", GENERATOR_REVISION: definition[:16]},
    )
    return FrameSet(facts, frames)


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Frames in ``night``; in ``out`` results of two solvers on three conditions, and of one of them on two more."""
    root = tmp_path_factory.mktemp("appended")
    folder = write_dataset(root / "night", (1, 2, 3, 4, 5), per_class=2)
    one, two = (Settled(name, open_dataset(folder).frames) for name in ("one", "two"))
    engine.run(part(folder, SHORT, VALUES[:3]), [one, two], root / "out")
    for value in VALUES[3:]:
        engine.run(part(folder, LONG, VALUES, value), [one], root / "out")
    pack_tree(root / "out")
    return root


@pytest.fixture
def out(solved, tmp_path):
    return shutil.copytree(solved / "out", tmp_path / "out")


def test_results_of_the_new_conditions_complete_those_before(solved, out, tmp_path):
    night, today = solved / "night", part(solved / "night", LONG, VALUES)
    before = {row.solver: row for row in read_packed(out / LISTING)}
    found = confirm(out, today, EARLIER)
    assert (found.n_frames, found.solvers, found.lacking) == (10, ("one",), ("two",))
    after = {row.solver: row for row in read_packed(out / LISTING)}
    assert after["two"].provenance == before["two"].provenance
    assert sorted(path.name for path in (out / "night@1").iterdir()) == ["dev.json", "dev.parquet"]
    # What is left is as one run over all conditions would have it.
    (whole,) = engine.run(today, [Settled("one", open_dataset(night).frames)], tmp_path / "whole")
    pack_tree(tmp_path / "whole")
    (expected,) = read_packed(tmp_path / "whole" / LISTING)
    changing = ["time_ms", "peak_memory_mib"]
    assert after["one"].frames.drop(columns=changing).equals(expected.frames.drop(columns=changing))
    assert after["one"].key == expected.key == whole.folder.name.removeprefix("one-")
    mine, its = (dict(row.provenance["frames"]) for row in (after["one"], expected))
    assert mine.pop("rendered_with") == before["one"].provenance["frames"]["rendered_with"]
    assert mine.pop("rendered_again_with") == its.pop("rendered_with")
    its.pop("rendered_again_with")
    assert mine == its


def test_another_revision_of_the_solver_does_not_complete_them(solved, out):
    shutil.rmtree(out / "night@1")
    night = solved / "night"
    frames = open_dataset(night).frames
    engine.run(part(night, SHORT, VALUES[:3]), [Settled("one", frames, revision="older")], out)
    for value in VALUES[3:]:
        engine.run(part(night, LONG, VALUES, value), [Settled("one", frames)], out)
    pack_tree(out)
    before = (out / LISTING).read_bytes()
    assert confirm(out, part(night, LONG, VALUES), EARLIER).lacking == ("one",)
    assert (out / LISTING).read_bytes() == before


def write_task(
    folder, values: str, tilt: str = "0.01", heading: str = "0.2", disk: str = "0", support: str = "10", sky: str = ""
):
    """A small task."""
    folder.mkdir()
    (folder / "small.task.yaml").write_text(
        f"""name: small
revision: 1
title: How hard it may be
licence: CC-BY-4.0
scenario: small.scenario.yaml
condition: {{name: what is graded, unit: px, values: {values}, harder: higher}}
instruments: {{tilt_sigma_deg: {tilt}, heading_sigma_deg: {heading}}}
splits: {{dev: {{seed: 1}}, test: {{seed: 2}}}}
metric: {{name: success_10km, unit: "1", better: higher}}
frames_per_condition: 10
half_width_points: 26.3
"""
    )
    (folder / "small.scenario.yaml").write_text(
        f"""name: task-small
site: {{latitude_deg: {{sphere_latitude: [-70, 70]}}, longitude_deg: {{uniform: [-180, 180]}}}}
time: {{utc_start: 2020-01-01T00:00:00Z, exposure_s: 0.5}}
camera:
  width: 64
  height: 48
  hfov_deg: 60
  aperture_mm: 4
  psf: {{gaussian_sigma_px: 0.6, support_px: {support}, defocus_disk_px: {disk}}}
sky: {{{sky}}}
"""
    )
    return load_task("small", folder)


def swept(values: str) -> str:
    return f"{{sweep: {values}, zip: disk}}"


def test_a_swept_task_is_known_without_its_last_conditions(tmp_path):
    few, many = "[1, 2, 3, 4]", "[1, 2, 3, 4, 5, 6]"
    before = write_task(tmp_path / "before", few, disk=swept(few))
    after = write_task(tmp_path / "after", many, disk=swept(many), support=swept("[10, 10, 10, 10, 12, 14]"))
    assert earlier_definitions(after)[before.sha256] == 4
    assert set(earlier_definitions(after).values()) == {3, 4, 5}
    # The frames that were there are drawn as they were.
    mine, its = before.scenario_of("dev"), after.scenario_of("dev")
    assert (mine.frame_count, its.frame_count) == (40, 60)
    assert [its.frame(index) for index in (0, 17, 39)] == [mine.frame(index) for index in (0, 17, 39)]


def test_a_task_whose_new_conditions_are_graded_by_another_key_is_known_without_them(tmp_path):
    named = swept("[null, null, null, 16, 15.5]")
    before = write_task(tmp_path / "before", "[7, 8, 9]", sky="bortle: {sweep: [7, 8, 9]}")
    after = write_task(
        tmp_path / "after",
        "[7, 8, 9, 10, 11]",
        sky=f"bortle: {swept('[7, 8, 9, null, null]')}, zenith_mag_arcsec2: {named}",
    )
    assert earlier_definitions(after)[before.sha256] == 3
    mine, its = before.scenario_of("dev"), after.scenario_of("dev")
    assert [its.frame(index) for index in (0, 17, 29)] == [mine.frame(index) for index in (0, 17, 29)]
    assert its.frame(30).sky.zenith_mag_arcsec2 == 16


def test_a_task_graded_by_what_is_told_is_known_without_its_last_conditions(tmp_path):
    few, many = "[0, 1, 2]", "[0, 1, 2, 3, 4]"
    before = write_task(tmp_path / "before", few, few)
    after = write_task(tmp_path / "after", many, many, heading="[0.2, 0.2, 0.2, 1, 2]")
    assert earlier_definitions(after)[before.sha256] == 3
    first, its = before.definition.instruments, after.definition.instruments
    assert [its.at(level) for level in range(3)] == [first.at(level) for level in range(3)]
    frames = [task.scenario_of("dev").frame(29) for task in (before, after)]
    assert frames[0] == frames[1]
    # Told another heading at a condition that was there, it is another definition.
    other = write_task(tmp_path / "other", many, many, heading="[0.2, 0.3, 0.2, 1, 2]")
    assert before.sha256 not in earlier_definitions(other)


def test_sequences_gain_no_conditions():
    assert earlier_definitions(load_task("uav")) == {}
