"""Attacks on a round, each by code of its own, gain nothing: linking copies, trying seeds, spying, metadata, order, sizes.

Every attack is first shown to work where its weakness is there: a test that could not find anything would prove nothing. The
secret is fixed, so that statistical attacks give the same each time; their false-alarm rate is FALSE_ALARM.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import os
import shutil
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import stats
from small_rounds import SECRET, SmallRound, make_round, small_key, small_rules

import celnav
from benchmark.errors import RoundError
from benchmark.frames.dataset import open_dataset
from benchmark.rounds.commitment import commitment_sha256
from benchmark.rounds.drawing import draw_frames
from benchmark.rounds.private_frames import check_different, read_frames
from benchmark.rounds.secret import RoundKey
from benchmark.rounds.steps import check_apart, frames_to_score
from benchmark.run.contestants import contestant_of
from benchmark.run.engine import outcomes
from benchmark.run.sessions import SessionPool
from benchmark.solvers.definition import SolverFolder, SolverSpec
from benchmark.solvers.isolation import isolation_obstacle
from benchmark.submit.pack import pack
from generator.places.times import Instant
from generator.seeds import random_stream

pytestmark = pytest.mark.journey

FALSE_ALARM = 1e-4
FRAMES = 12
PROGRAMS = Path(__file__).parents[1] / "unit" / "benchmark" / "programs"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> SmallRound:
    return make_round(tmp_path_factory.mktemp("round"), FRAMES, {"walker": "1"})


def images(folder: Path) -> dict[str, np.ndarray]:
    found = {}
    for path in sorted(folder.glob("*.png")):
        with Image.open(path) as picture:
            found[path.stem] = np.asarray(picture).astype(np.float64)
    return found


def records(folder: Path) -> dict[str, dict]:
    listed = [entry["frame_id"] for entry in json.loads((folder / "frames.json").read_text())]
    return {name: json.loads((folder / f"{name}.json").read_text()) for name in listed}


# Linking: a graded task that shows one image seven times, with seven attitudes, gives its truth by their mean.


def linked_pairs(pictures: dict[str, np.ndarray], limit: float = 0.9) -> list[tuple[str, str]]:
    """Pairs of images that show the same stars: correlated over their brightest hundredth, whatever was added to them."""
    flat = {}
    for name, image in pictures.items():
        stars = np.clip(image - np.quantile(image, 0.99), 0.0, None)
        flat[name] = (image.shape, (stars - stars.mean()).ravel() / max(stars.std(), 1e-9) / math.sqrt(stars.size))
    names = sorted(flat)
    return [
        (one, other)
        for place, one in enumerate(names)
        for other in names[place + 1 :]
        if flat[one][0] == flat[other][0] and flat[one][1] @ flat[other][1] > limit
    ]


def test_no_two_images_can_be_linked(made: SmallRound) -> None:
    pictures = images(made.packed)
    assert len(pictures) == FRAMES
    assert len({hashlib.sha256(image.tobytes()).hexdigest() for image in pictures.values()}) == FRAMES
    assert linked_pairs(pictures) == []
    # A copy with another noise is found by the same attack.
    name, image = next(iter(pictures.items()))
    noisy = image + np.random.default_rng(1).normal(0.0, 1.0, image.shape)
    assert linked_pairs(pictures | {"copy": noisy}) == [tuple(sorted(("copy", name)))]


def test_no_two_frames_have_one_sky() -> None:
    """Of 400 frames, no two at one place and time: solvers cannot average what they are told over copies."""
    frames = [frame.scenario.frame(0) for frame in draw_frames(small_rules(), small_key(), 400)]
    places = {(frame.site.latitude_deg, frame.site.longitude_deg) for frame in frames}
    assert len(places) == len({str(frame.time.utc_start) for frame in frames}) == 400
    assert len({(frame.attitude.azimuth_deg, frame.attitude.roll_deg) for frame in frames}) == 400


def test_a_round_with_a_copy_is_not_packed(made: SmallRound) -> None:
    frames = read_frames(made.drawn.frames, made.truth, made.drawn.key)
    twice = [frames[0], dataclasses.replace(frames[0], frame_id="copy")]
    with pytest.raises(RoundError, match="two frames have the same image"):
        check_different(twice)


# Seeds: 32 bits fall in minutes to one number of full precision that they gave.


def seeds_that_fit(azimuth_deg: float, within_deg: float, seeds: range) -> list[int]:
    """Seeds of a plain scenario whose first frame has this azimuth."""
    draws = (random_stream(seed, "scenario:attitude.azimuth_deg", 0).uniform(0.0, 360.0) for seed in seeds)
    return [seed for seed, draw in zip(seeds, draws, strict=True) if abs(draw - azimuth_deg) <= within_deg]


def test_a_plain_seed_falls_to_full_precision_and_not_to_what_is_told(made: SmallRound) -> None:
    seeds, secret = range(6000), 4321
    exact = random_stream(secret, "scenario:attitude.azimuth_deg", 0).uniform(0.0, 360.0)
    assert seeds_that_fit(exact, 1e-9, seeds) == [secret]
    # A round tells an azimuth with an error of half a degree and more: by chance alone, many seeds fit every frame.
    for record in records(made.packed).values():
        if record["attitude"]["heading_sigma_deg"] is not None:
            within = 3 * record["attitude"]["heading_sigma_deg"]
            fits = len(seeds_that_fit(record["attitude"]["azimuth_deg"], within, seeds))
            expected = len(seeds) * 2 * within / 360
            assert abs(fits - expected) < stats.norm.isf(FALSE_ALARM / FRAMES / 2) * math.sqrt(expected)


def secrets_that_fit(told: dict[str, dict], candidates: list[bytes]) -> list[bytes]:
    """Secrets whose frames agree with what is told, in times and altitudes, within five standard deviations."""
    found = []
    for secret in candidates:
        key = RoundKey.of(secret, small_rules().sha256, "")
        drawn = {frame.name: frame for frame in draw_frames(small_rules(), key, 3)}
        fits = [name for name in drawn if name in told]
        altitudes = {name: drawn[name].scenario.frame(0).attitude.altitude_deg for name in fits}
        sigma = {name: told[name]["attitude"]["tilt_sigma_deg"] for name in fits}
        if fits and all(abs(told[n]["attitude"]["altitude_deg"] - altitudes[n]) < 5 * sigma[n] for n in fits):
            found.append(secret)
    return found


def test_a_secret_is_found_only_by_who_knows_all_but_a_few_of_its_bits(made: SmallRound) -> None:
    told = records(made.packed)
    near = [SECRET[:-1] + bytes([last]) for last in range(SECRET[-1] - 8, SECRET[-1] + 8)]
    assert secrets_that_fit(told, near) == [SECRET]  # the attack works
    far = [hashlib.sha256(bytes([number])).digest()[:16] for number in range(16)]
    assert secrets_that_fit(told, far) == []
    # What is left to a search: 2^128 secrets, each a hash away from the published commitment; names are no shorter way.
    terms = made.drawn.commitment.terms
    assert commitment_sha256(SECRET, terms) == made.drawn.commitment.sha256
    assert made.drawn.commitment.sha256 not in {commitment_sha256(secret, terms) for secret in [*near, *far]} - {
        commitment_sha256(SECRET, terms)
    }


# Spying: the truth beside the image, above it, or in what is published.


def numbers_of_the_truth(made: SmallRound) -> list[str]:
    """Latitudes and longitudes as a file would hold them, to five digits or more after the point."""
    sites = [one.scenario.frame(0).site for one in made.drawn.frames]
    return [repr(value)[:10] for site in sites for value in (site.latitude_deg, site.longitude_deg)]


def test_nothing_that_is_published_holds_the_truth(made: SmallRound) -> None:
    public = [path for folder in (made.folder, made.packed) for path in sorted(folder.rglob("*")) if path.is_file()]
    text = b"\n".join(path.read_bytes() for path in public if path.suffix != ".png").decode()
    truth = b"\n".join(path.read_bytes() for path in made.truth.rglob("*.json")).decode()
    wanted = numbers_of_the_truth(made)
    assert all(number in truth for number in wanted)  # where it is, it is found
    assert not [number for number in wanted if number in text]
    assert not [
        word
        for word in ("latitude", "longitude", "seed", "star_id", "skybench-stars", "scenario")
        if f'"{word}' in text
    ]
    assert SECRET.hex() not in text
    for frame in made.drawn.frames:
        assert frame.scenario.content_sha256 not in text
        assert str(frame.scenario.seed) not in text


@pytest.mark.skipif(bool(isolation_obstacle()), reason=f"no namespaces here: {isolation_obstacle()}")
def test_a_program_that_walks_from_its_image_finds_no_truth(made: SmallRound, tmp_path: Path) -> None:
    shutil.copyfile(PROGRAMS / "walker.py", tmp_path / "walker.py")
    spec = SolverSpec(name="walker", title="A walker", licence="MIT", version="1", command=("python", "walker.py"))
    contestant = contestant_of(SolverFolder(tmp_path, spec))
    frames = frames_to_score(made.folder, made.drawn, made.truth, made.packed, later=False).frames[:2]
    pool = SessionPool(lambda: contestant.make_session(1), 1)
    try:
        reasons = [json.loads(outcome.score.reason) for outcome in outcomes(frames, pool, "own", {})]
    finally:
        pool.close()
    for reason in reasons:
        assert reason == {"beside": 1, "telling": []}


def test_a_folder_with_truth_never_holds_images_for_solvers(made: SmallRound) -> None:
    frames = frames_to_score(made.folder, made.drawn, made.truth, made.packed, later=False).frames
    for frame in frames:
        beside = {path.name for path in frame.image_path.parent.iterdir()}
        assert not [name for name in beside if name.startswith("frame-") or name.endswith((".parquet", ".yaml"))]
        assert not frame.image_path.resolve().is_relative_to(made.truth.resolve())
    truth = made.truth
    for inner, other in (
        (truth / "set", truth),
        (truth, truth / "set"),
        (truth, truth),
        (truth / ".." / "truth", truth),
    ):
        with pytest.raises(RoundError, match="one lies in the other"):
            check_apart(inner, {"the truth": other})


# Metadata: chunks, tags, dates, rights.


def chunks_of(content: bytes) -> list[str]:
    """Names of a PNG's chunks; bytes after the last are a chunk ``trailing``. Raises where a check sum is wrong."""
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    place, found = 8, []
    while place < len(content) and (not found or found[-1] != "IEND"):
        (length,) = struct.unpack(">I", content[place : place + 4])
        name, body = content[place + 4 : place + 8], content[place + 8 : place + 8 + length]
        assert struct.unpack(">I", content[place + 8 + length : place + 12 + length]) == (zlib.crc32(name + body),)
        found.append(name.decode())
        place += 12 + length
    return found + (["trailing"] if place < len(content) else [])


def test_files_hold_nothing_but_pixels_and_what_is_told(made: SmallRound) -> None:
    for path in sorted(made.packed.iterdir()):
        state = path.stat()
        assert (state.st_mtime_ns, state.st_mode & 0o777) == (946_684_800 * 10**9, 0o644)
        assert os.listxattr(path) == []
        if path.suffix == ".png":
            assert sorted(set(chunks_of(path.read_bytes()))) == ["IDAT", "IEND", "IHDR"]
    told = records(made.packed)
    assert {tuple(record) for record in told.values()} == {
        ("format", "frame_id", "time", "camera", "camera_sigma", "attitude", "atmosphere")
    }
    stream = io.BytesIO()
    Image.fromarray(np.zeros((4, 4), np.uint16)).save(stream, format="PNG", dpi=(72, 72))
    assert "pHYs" in chunks_of(stream.getvalue())  # metadata, where there is some, is seen
    assert chunks_of(stream.getvalue() + b"site")[-1] == "trailing"


# Order: names, lists and places on the disk in the order of drawing, or of anything that was drawn.


def test_names_tell_neither_the_order_of_drawing_nor_what_was_drawn() -> None:
    frames = draw_frames(small_rules(), small_key(), 1500)
    numbers = [int(frame.name[1:], 16) for frame in frames]
    specs = [frame.scenario.frame(0) for frame in frames]
    drawn = {
        "index": [frame.index for frame in frames],
        "latitude": [spec.site.latitude_deg for spec in specs],
        "longitude": [spec.site.longitude_deg for spec in specs],
        "altitude": [spec.attitude.altitude_deg for spec in specs],
        "Bortle class": [spec.sky.bortle for spec in specs],
        "width": [spec.camera.width for spec in specs],
        "tilt": [frame.precision.tilt_sigma_deg for frame in frames],
    }
    for name, values in drawn.items():
        assert stats.spearmanr(numbers, values).pvalue > FALSE_ALARM, name
        assert stats.spearmanr([number % 251 for number in numbers], values).pvalue > FALSE_ALARM, name
    assert (
        stats.spearmanr(sorted(numbers), drawn["index"]).pvalue < FALSE_ALARM
    )  # names in the order of drawing tell it


def test_lists_and_the_disk_have_the_order_of_the_names(made: SmallRound, tmp_path: Path) -> None:
    listed = [entry["frame_id"] for entry in json.loads((made.packed / "frames.json").read_text())]
    assert listed == sorted(frame.name for frame in made.drawn.frames)
    # The same files again from frames in another order: the same bytes, in the same order.
    frames = read_frames(made.drawn.frames, made.truth, made.drawn.key)
    pack(frames[::-1], tmp_path / "again", names={frame.frame_id: frame.frame_id for frame in frames})
    for path in sorted(made.packed.iterdir()):
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes()


# Sizes.


def test_sizes_of_files_tell_nothing_that_their_contents_do_not(made: SmallRound) -> None:
    """A size follows from what the solver is given anyway, so that padding would hide nothing: made again from it alone."""
    for name, record in records(made.packed).items():
        with Image.open(made.packed / f"{name}.png") as picture:
            pixels = np.asarray(picture).astype(np.uint16)
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, format="PNG")
        assert stream.getvalue() == (made.packed / f"{name}.png").read_bytes()
        assert (json.dumps(record, indent=1) + "\n").encode() == (made.packed / f"{name}.json").read_bytes()


# Precision: what is told must not be better than it says.


def test_what_is_told_is_not_the_truth(made: SmallRound) -> None:
    """Told matrices, times and cameras are off by what they state: chi-squared of all frames, and none is exact."""
    told = records(made.packed)
    tilts, late_s = [], []
    for one in made.drawn.frames:
        (frame,) = open_dataset(made.truth / f"{one.index:05d}").frames
        given, true = told[one.name], frame.observation
        late_s.append(
            Instant.parse(given["time"]["utc_mid"]).since(Instant.parse(true.utc)) / given["time"]["utc_sigma_s"]
        )
        assert given["camera"]["f_px"] != true.camera.f_px
        vertical = np.asarray(given["attitude"]["R_cam"])[:, 2] @ np.asarray(true.R_cam)[:, 2]
        tilts.append(math.degrees(math.acos(min(vertical, 1.0))) / given["attitude"]["tilt_sigma_deg"])
        assert (
            celnav.Pointing.of(given["attitude"]["R_cam"]).altitude_deg != one.scenario.frame(0).attitude.altitude_deg
        )
    for errors, degrees in ((tilts, 2 * FRAMES), (late_s, FRAMES)):
        tail = stats.chi2(degrees).cdf(sum(error**2 for error in errors))
        assert FALSE_ALARM / 2 < tail < 1 - FALSE_ALARM / 2
