"""Sequences: frames in order to one process, graded by the frames so far; what is told errs alike in all of them."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from unit.benchmark.fake_night import write_dataset
from unit.benchmark.stored import detections, stored
from unit.benchmark.test_engine_resumes import Counting, StoppedError
from unit.benchmark.test_tasks import SEEN, TINY, TINY_SCENARIO

import celnav
from benchmark.errors import TaskError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import ungraded
from benchmark.frames.task_frames import FrameChoice, make_task_frames
from benchmark.instruments import told
from benchmark.judge.frame_bounds import bound_of
from benchmark.protocol import Answer, SequencePlace
from benchmark.run import engine
from benchmark.run.contestants import contestant_of
from benchmark.run.engine import outcomes
from benchmark.run.sessions import SessionPool
from benchmark.solvers.celnav_solver import answer_of
from benchmark.solvers.definition import SolverFolder, SolverSpec
from benchmark.solvers.messages import request_of
from benchmark.solvers.sequence_track import SequenceTrack, without_bias
from benchmark.solvers.serve import answer_request
from benchmark.submit.pack import public_record
from benchmark.tasks.definition import Instruments, load_task
from generator.seeds import random_stream

PROGRAM = Path(__file__).parent / "programs" / "remembering.py"
KM_PER_DEG = math.pi / 180 * 6371.0088
LENGTH = 3


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Nine frames, said to be three sequences of three."""
    found = open_dataset(write_dataset(tmp_path_factory.mktemp("data") / "night", (1, 2, 3), per_class=3))
    return dataclasses.replace(found, frames=tuple(placed(frame) for frame in found.frames))


def placed(frame):
    place = SequencePlace(f"sequence-{frame.index // LENGTH:05d}", frame.index % LENGTH, LENGTH, 0.5)
    return dataclasses.replace(frame, observation=dataclasses.replace(frame.observation, sequence=place))


def accounts(tmp_path, way, frames, jobs=1):
    """Status of each frame and what the program says of it: its index, how many it has seen, how many images there are."""
    (tmp_path / "program.py").write_bytes(PROGRAM.read_bytes())
    spec = SolverSpec(name="mine", title="A program", licence="MIT", version="1", command=("python", "program.py", way))
    contestant = contestant_of(SolverFolder(tmp_path, spec))
    pool = SessionPool(lambda: contestant.make_session(jobs), jobs)
    try:
        judged = list(outcomes(frames, pool, "own", {}))
    finally:
        pool.close()
    assert [one.score.frame_id for one in judged] == [frame.frame_id for frame in frames]
    return [(one.score.status, *one.details.stage_ms.values()) for one in judged]


def test_a_sequence_goes_to_one_process_in_order_one_image_at_a_time(dataset, tmp_path):
    # Were the warm-up a frame of the sequence, or another process given one of them, the numbers seen would be others.
    expected = [("fix", index, index + 1, 1) for index in range(LENGTH)] * 3
    assert accounts(tmp_path, "well", dataset.frames, jobs=2) == expected


def test_a_program_that_crashes_within_a_sequence_goes_on_with_the_next_frame_and_an_empty_memory(dataset, tmp_path):
    found = accounts(tmp_path, "crash", dataset.frames)
    assert found == [("fix", 0, 1, 1), ("error",), ("fix", 2, 1, 1)] * 3


def test_an_interrupted_sequence_is_put_again_from_its_first_frame(dataset, tmp_path):
    frames = ungraded(dataset, "night")
    done = []

    def progress(name, count):
        done.extend([name] * count)
        if len(done) == LENGTH + 1:
            raise StoppedError

    with pytest.raises(StoppedError):
        engine.run(frames, [Counting("truth", dataset.frames)], tmp_path / "cut", progress=progress)
    second = Counting("truth", dataset.frames)
    engine.run(frames, [second], tmp_path / "cut")
    # The warm-up, then the second sequence, of which one frame was done, and the third.
    times = [frame.observation.utc for frame in dataset.frames]
    assert second.asked == [times[LENGTH], *times[LENGTH:]]
    engine.run(frames, [Counting("truth", dataset.frames)], tmp_path / "whole")
    cut, whole = stored(tmp_path / "cut")["truth"], stored(tmp_path / "whole")["truth"]
    for column in ("frame_id", "error_km", "n_correct"):
        assert cut.frames[column].equals(whole.frames[column])
    assert detections(cut).equals(detections(whole))


def test_the_place_in_the_sequence_reaches_an_adapter_and_a_submission(dataset):
    heard = []

    class Listening:
        def detect(self, image):
            raise AssertionError("detections are given")

        def solve(self, detections, observation):
            heard.append(observation.sequence)
            return Answer(False, "listens")

    frame = dataset.frames[4]
    given = celnav.Detections(frame.truth.uv, None, (frame.observation.camera.height, frame.observation.camera.width))
    request = request_of(frame, given, frame.image_path)
    assert request["sequence"] == {"id": "sequence-00001", "index": 1, "length": 3, "tilt_bias_sigma_deg": 0.5}
    answer_request(Listening(), request)
    by_itself = dataclasses.replace(frame, observation=dataclasses.replace(frame.observation, sequence=None))
    alone = request_of(by_itself, given, frame.image_path)
    assert "sequence" not in alone
    answer_request(Listening(), alone)
    assert heard == [frame.observation.sequence, None]
    assert public_record("x", frame)["sequence"] == request["sequence"]
    assert "sequence" not in public_record("x", by_itself)


SEQUENCES = TINY_SCENARIO.replace("exposure_s: 0.5}", "exposure_s: 0.5, every_s: 60, count: 3}").replace(
    "{sweep: [5.0, 4.0, 3.0]}", "5.0"
)
BY_FRAMES = TINY.replace("[5.0, 4.0, 3.0]", "[3, 2, 1]").replace(
    "metric:", "instruments: {tilt_sigma_deg: 0.3, tilt_bias_sigma_deg: 0.5, focal_sigma: 0.01}\nmetric:"
)


def write_task(folder, definition=BY_FRAMES, scenario=SEQUENCES):
    (folder / "tiny.task.yaml").write_text(definition)
    (folder / "tiny.scenario.yaml").write_text(scenario)
    return load_task("tiny", folder)


def test_frames_of_a_task_of_sequences_are_graded_by_how_many_came_before(tmp_path):
    task = write_task(tmp_path)
    assert (task.sequence_length, task.scenario_of("dev").frame_count) == (3, 30)
    found = make_task_frames(task, "tiny", FrameChoice(per_condition=2, data=tmp_path, workers=0))
    assert [frame.condition for frame in found.frames] == [1, 2, 3, 1, 2, 3]
    places = [frame.observation.sequence for frame in found.frames]
    assert [(one.sequence_id[-1], one.index, one.length) for one in places] == [
        (str(number), index, 3) for number in range(2) for index in range(3)
    ]
    # Lens: alike within a sequence, another in the next. Time: of the clock.
    lenses = [frame.observation.camera for frame in found.frames]
    assert len(set(lenses[:3])) == len(set(lenses[3:])) == 1
    assert lenses[0] != lenses[3]
    assert len({frame.conditions.latitude_deg for frame in found.frames}) == 1
    assert len({frame.observation.utc for frame in found.frames}) == 6
    # Of the stars' light a frame by itself has a bound; after it a solver may know more.
    assert [bound_of(frame) is None for frame in found.frames] == [False, True, True] * 2
    with pytest.raises(TaskError, match="leave out the condition"):
        make_task_frames(task, "tiny", FrameChoice(per_condition=1, condition=3, data=tmp_path, workers=0))


@pytest.mark.parametrize(
    ("old", "new"),
    [("[3, 2, 1]", "[4, 2, 1]"), ("tilt_sigma_deg: 0.3", "tilt_sigma_deg: [0.1, 0.2, 0.3]")],
)
def test_a_task_of_sequences_is_graded_by_frames_alone(tmp_path, old, new):
    with pytest.raises(TaskError, match="graded by their frames so far, from 3 to 1"):
        write_task(tmp_path, BY_FRAMES.replace(old, new))


def test_part_of_the_verticals_error_stands_still_in_the_camera():
    still = Instruments(tilt_bias_sigma_deg=0.5).at(0)
    turned = dataclasses.replace(SEEN, R_cam=Rotation.from_euler("z", 77, degrees=True).as_matrix() @ SEEN.R_cam)
    off = []
    for number in range(1000):
        one, other = (
            told(seen, still, random_stream(1, "own", index), random_stream(1, "alike", number))
            for index, seen in enumerate((SEEN, turned))
        )
        assert one.tilt_sigma_deg == 0.5
        turns = [each.R_cam @ seen.R_cam.T for each, seen in ((one, SEEN), (other, turned))]
        assert turns[0] == pytest.approx(turns[1], abs=1e-12)
        off.append(Rotation.from_matrix(turns[0]).as_rotvec(degrees=True))
    # The standard deviation of 1000 Gaussian numbers is within 10 % of theirs with a probability of 1 - 8e-6.
    assert np.std(off, axis=0)[:2] == pytest.approx([0.5, 0.5], rel=0.1)
    assert np.abs(off)[:, 2].max() < 1e-9
    both = Instruments(tilt_sigma_deg=0.3, tilt_bias_sigma_deg=0.4, heading_sigma_deg=2.0).at(0)
    both = told(SEEN, both, random_stream(1, "own", 0))
    assert both.tilt_sigma_deg == 0.501  # hypot(0.3, 0.4), and the rounding to 0.1 deg


PLACE = 40.0, -30.0
BIAS_DEG = 0.5, -0.3


def turned_observation(number, index):
    """A camera 8 deg off the zenith, turned by 45 deg a frame, its vertical off by a fixed tilt in its own axes."""
    leaning = Rotation.from_euler("z", -45.0 * index, degrees=True) * Rotation.from_euler("x", 8, degrees=True)
    true = leaning.as_matrix().T
    wrong = Rotation.from_rotvec([*BIAS_DEG, 0.0], degrees=True).as_matrix() @ true
    # The place whose zenith is the vertical that is told: its east and north in the true place's frame.
    east, north = (true.T @ wrong[:, 2])[:2] * 6371.0088
    place = SequencePlace(f"sequence-{number}", index, 8, 0.5)
    utc = f"2020-01-01T00:{index:02d}:00Z"
    seen = dataclasses.replace(SEEN, utc=utc, R_cam=wrong, tilt_sigma_deg=math.hypot(0.3, 0.5), sequence=place)
    return seen, east, north


def found_at(east, north, ok=True):
    if not ok:
        return celnav.Fix(ok=False, reason=celnav.Reason.NO_HYPOTHESIS)
    lat = PLACE[0] + north / KM_PER_DEG
    lon = PLACE[1] + east / (KM_PER_DEG * math.cos(math.radians(PLACE[0])))
    noise = np.eye(2) * (0.3 * KM_PER_DEG) ** 2
    return celnav.Fix(ok=True, reason=celnav.Reason.OK, lat_deg=lat, lon_deg=lon, cov_km2=noise, confidence=0.9)


def off_km(answer):
    north = (answer.lat_deg - PLACE[0]) * KM_PER_DEG
    return math.hypot(north, (answer.lon_deg - PLACE[1]) * KM_PER_DEG * math.cos(math.radians(PLACE[0])))


def tracked(fixes, track=None, number=0):
    """Answers of a track to one fix after another; a fix is what it is off beside the vertical's error, None a refusal."""
    track = SequenceTrack() if track is None else track
    answers = []
    for index, extra in enumerate(fixes):
        seen, east, north = turned_observation(number, index)
        assert without_bias(seen).tilt_sigma_deg == pytest.approx(0.3)
        fix = found_at(east + (extra or 0.0), north, ok=extra is not None)
        answers.append(track.answer(answer_of(fix), fix, seen))
    return answers


def test_a_camera_that_turns_tells_the_error_of_its_vertical_from_its_place():
    answers = tracked([0.0] * 8)
    sigmas = [math.sqrt(np.trace(answer.cov_km2) / 2) for answer in answers]
    assert off_km(answers[0]) == pytest.approx(math.hypot(*BIAS_DEG) * KM_PER_DEG, rel=0.02)
    assert sigmas[0] == pytest.approx(math.hypot(0.3, 0.5) * KM_PER_DEG, rel=0.01)
    assert off_km(answers[3]) < 10.0  # the mean of these four fixes is 42 km off
    # A full turn takes the bias away, and leaves the noise over the root of the number of frames.
    assert off_km(answers[7]) < 2.0
    assert sigmas[7] == pytest.approx(0.3 * KM_PER_DEG / math.sqrt(8), rel=0.01)
    assert sigmas == sorted(sigmas, reverse=True)


def test_a_wrong_fix_does_not_bar_those_that_follow_and_a_refusal_is_answered_by_them():
    answers = tracked([4000.0, 0.0, 0.0, None])
    assert off_km(answers[0]) > 3900
    assert off_km(answers[2]) < 100
    assert answers[3].ok
    assert len(answers[3].matches) == 0
    assert (answers[3].lat_deg, answers[3].confidence) == (answers[2].lat_deg, 0.9)


def test_another_sequence_begins_anew():
    track = SequenceTrack()
    first = tracked([0.0] * 8, track, 0)
    again = tracked([None, 0.0], track, 1)
    assert not again[0].ok
    assert np.trace(again[1].cov_km2) == pytest.approx(np.trace(first[0].cov_km2), rel=0.05)
