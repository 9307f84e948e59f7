"""A round from its commitment to its opening: the four commands, and what they refuse."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from small_rounds import RULES, SECRET
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.cli.rounds import scoring
from benchmark.errors import RoundError
from benchmark.report.site.tree import read_tree
from benchmark.rounds.commitment import read_commitment
from benchmark.rounds.scored_answers import settle_answers
from benchmark.rounds.steps import verify_round
from benchmark.run.packing import pack_tree
from benchmark.run.shared_detections import SHARED_DETECTIONS, shared_detector
from benchmark.solvers.registry import solver_folder

pytestmark = pytest.mark.journey

FRAMES = 4
SETTLED = {
    SHARED_DETECTIONS: shared_detector(),
    "skybench": solver_folder("skybench").revision,
    "theirs": "0a1b",
}


def skybench(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(app, ["bench", "round", *map(str, arguments)])
    assert done.exit_code == code, done.output
    return done.output


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A round that was committed to, packed, scored and opened."""
    place = tmp_path_factory.mktemp("round")
    (place / "small.rules.yaml").write_text(RULES)
    terms = (
        "--rules",
        place / "small.rules.yaml",
        "--frames",
        FRAMES,
        "--solver",
        "skybench",
        "--entrant",
        "theirs=0a1b",
    )
    beacon = ("--beacon", "drand round 5")
    with pytest.MonkeyPatch.context() as patch:
        # The same frames in each run of the tests.
        patch.setattr("benchmark.rounds.secret.secrets.token_bytes", lambda count: SECRET)
        skybench("draw", "--secret", place / "secret.hex", *terms, *beacon, "--out", place / "public" / "first")
    return place


def step(place: Path, command: str, *more: object, code: int = 0) -> str:
    known = ("--secret", place / "secret.hex", "--truth", place / "truth", "--beacon", "c0ffee")
    return skybench(command, place / "public" / "first", *known, *more, code=code)


@pytest.fixture(scope="module")
def scored(place) -> Path:
    step(place, "pack", "--out", place / "set")
    step(place, "score", "--set", place / "set", "--solver", "skybench")
    step(place, "score", "--set", place / "set", "--answers", place / "set" / "answers.csv", "--name", "theirs")
    return place


@pytest.fixture(scope="module")
def opened(scored) -> Path:
    step(scored, "open")
    return scored


def test_a_commitment_names_what_was_settled_and_no_secret(place) -> None:
    text = (place / "public" / "first" / "commitment.json").read_text()
    terms = json.loads(text)
    assert terms["contestants"] == SETTLED
    assert (terms["name"], terms["frames"], terms["beacon"]) == ("first", FRAMES, "drand round 5")
    assert SECRET.hex() not in text
    words = skybench("draw", "--secret", place / "new.hex", "--out", place / "public" / "first", code=2)
    assert "must not change" in " ".join(words.split())
    assert not (place / "new.hex").exists()


def test_results_carry_the_frozen_revisions_and_the_frames_hashes(scored) -> None:
    results = {one.solver: one for group in read_tree(scored / "public" / "first" / "results") for one in group}
    assert set(results) == {"skybench", "theirs"}
    for one in results.values():
        assert one.provenance.frames.frozen == SETTLED
        assert one.frames["image_sha256"].nunique() == one.frames["truth_sha256"].nunique() == FRAMES
        assert one.frames["frame_id"].is_monotonic_increasing
    assert results["skybench"].provenance.solver.revision == solver_folder("skybench").revision
    assert results["skybench"].frames["crlb_km"].notna().all()  # the truth's record is found apart from the image
    assert (results["theirs"].frames["status"] == "refused").all()


def test_who_was_not_committed_to_is_kept_apart(scored) -> None:
    refused = step(scored, "score", "--set", scored / "set", "--solver", "thesis-adaptive", code=2)
    assert "was not committed to" in " ".join(refused.split())
    step(
        scored, "score", "--set", scored / "set", "--answers", scored / "set" / "answers.csv", "--name", "late", code=2
    )
    step(scored, "score", "--set", scored / "set", "--solver", "thesis-adaptive", "--later")
    apart = scored / "public" / "first" / "later"
    (path,) = apart.rglob("summary.json")
    assert path.relative_to(apart).parts[1] == "later"


def test_of_an_entrant_one_set_of_answers_counts(scored, tmp_path) -> None:
    other = tmp_path / "other.csv"
    other.write_text((scored / "set" / "answers.csv").read_text().replace("refused", "error"))
    given = ("--set", scored / "set", "--answers", other, "--name", "theirs")
    assert "one set of answers counts" in " ".join(step(scored, "score", *given, code=2).split())
    apart = step(scored, "score", *given, "--out", tmp_path / "apart", code=2)
    assert "one set of answers counts" in " ".join(apart.split())
    step(scored, "score", *given, "--later", "--out", tmp_path / "later")


def test_answers_that_were_scored_before_they_were_recorded_count_too(scored, tmp_path) -> None:
    """Raw, and packed into a table."""
    folder, committed = scored / "public" / "first", read_commitment(scored / "public" / "first")[0]
    copy = shutil.copytree(folder / "results", tmp_path / "first" / "results")
    version = json.loads((folder / "answers.json").read_text())["answers"]["theirs"]
    for _ in ("raw", "packed"):
        with pytest.raises(RoundError, match="one set of answers counts"):
            settle_answers(tmp_path / "first", committed, tmp_path / "elsewhere", "theirs", "sha256:another")
        with pytest.raises(RoundError, match="one set of answers counts"):
            settle_answers(tmp_path / "other", committed, copy, "theirs", "sha256:another")
        pack_tree(copy)
        assert not list(copy.rglob("summary.json"))
    settle_answers(tmp_path / "first", committed, tmp_path / "elsewhere", "theirs", version)
    settle_answers(tmp_path / "first", committed, tmp_path / "elsewhere", "others", "sha256:another")
    assert set(json.loads((tmp_path / "first" / "answers.json").read_text())["answers"]) == {"theirs", "others"}


def test_answers_that_come_after_the_secret_are_kept_apart(opened, tmp_path) -> None:
    """Whoever has the secret can make the truth."""
    given = ("--set", opened / "set", "--answers", opened / "set" / "answers.csv", "--name", "theirs")
    assert "anyone can make the truth" in " ".join(step(opened, "score", *given, code=2).split())
    step(opened, "score", *given, "--later", "--out", tmp_path / "later")


def test_all_solvers_can_be_given_the_same_detections(scored, tmp_path, monkeypatch) -> None:
    arguments = ("--set", scored / "set", "--solver", "skybench", "--detections", "shared", "--out", tmp_path)
    step(scored, "score", *arguments)
    ((one,),) = read_tree(tmp_path)
    assert (one.provenance.detections, one.provenance.solver.detector) == ("shared", shared_detector())
    monkeypatch.setattr(scoring, "shared_detector", lambda: "celnav-changed")
    assert f"{SHARED_DETECTIONS}: revision {shared_detector()} was committed to" in " ".join(
        step(scored, "score", *arguments, code=2).split()
    )


def test_another_set_secret_or_beacon_is_refused(scored, tmp_path) -> None:
    other = shutil.copytree(scored / "set", tmp_path / "set")
    record = sorted(path for path in other.glob("f*.json") if path.name != "frames.json")[0]
    record.write_text(record.read_text().replace('"utc_mid": "20', '"utc_mid": "19'))
    assert "is not the set" in " ".join(step(scored, "score", "--set", other, "--solver", "skybench", code=2).split())
    wrong = tmp_path / "secret.hex"
    wrong.write_text(SECRET[::-1].hex())
    arguments = ("--truth", scored / "truth", "--set", scored / "set", "--solver", "skybench")
    folder = scored / "public" / "first"
    assert "do not give the commitment" in " ".join(
        skybench("score", folder, "--secret", wrong, "--beacon", "c0ffee", *arguments, code=2).split()
    )
    assert "--beacon" in skybench("score", folder, "--secret", scored / "secret.hex", *arguments, code=2)


def test_anyone_can_verify_an_opened_round(opened) -> None:
    words = skybench("verify", opened / "public" / "first", "--render", 1)
    assert f"{FRAMES} scenarios, 1 frames rendered again" in " ".join(words.split())
    assert "make the set" not in words


def test_all_frames_make_the_set_whose_hash_was_published(opened, tmp_path) -> None:
    folder = shutil.copytree(opened / "public" / "first", tmp_path / "first", ignore=shutil.ignore_patterns("results"))
    assert "which make the set that solvers got" in " ".join(skybench("verify", folder, "--render", 99).split())
    text = (folder / "packed.json").read_text()
    (folder / "packed.json").write_text(text.replace('"set_sha256": "', '"set_sha256": "0'))
    assert "states another SHA-256" in " ".join(skybench("verify", folder, "--render", FRAMES, code=2).split())


@pytest.mark.parametrize(
    ("file", "before", "after", "words"),
    [
        ("commitment.json", '"skybench": "', '"skybench": "x', "do not give the commitment"),
        ("commitment.json", '"frames": 4', '"frames": 3', "do not give the commitment"),
        ("commitment.json", '"name": "first"', '"name": 5', "name"),
        ("commitment.json", "skybench-round/1", "skybench-round/0", "is not of the format"),
        ("rules.yaml", "share: 3", "share: 2", "are not the rules of"),
        ("packed.json", '"commitment_sha256": "', '"commitment_sha256": "0', "belongs to another commitment"),
        ("packed.json", '"frames": 4', '"frames": 3', "states 3 frames"),
        ("opened.json", '"secret": "8', '"secret": "7', "do not give the commitment"),
        ("opened.json", '"secret": "8', '"secret": "z', "is not hexadecimal"),
        ("opened.json", '"beacon": "c', '"beacon": "d', "other frames than its secret draws"),
        ("opened.json", '"beacon": "c0ffee"', '"beacon": ""', "as it was committed"),
        ("opened.json", '"scenario_sha256": "', '"scenario_sha256": "0', "other frames"),
        ("opened.json", "[", "[0", "is no JSON object"),
        ("opened.json", "[", "[0,", "must be a list of objects"),
        ("opened.json", '"secret": "8', '"secret": 8, "more": "', "needs the texts secret and beacon"),
        ("opened.json", '"image_sha256": "', '"image_sha256": "0', "another one when it is rendered again"),
        ("opened.json", '"truth_sha256": "', '"truth_sha256": "0', "another one when it is rendered again"),
    ],
)
def test_a_round_that_was_changed_is_noticed(opened, tmp_path, file, before, after, words) -> None:
    copy = shutil.copytree(opened / "public" / "first", tmp_path / "first", ignore=shutil.ignore_patterns("results"))
    text = (copy / file).read_text()
    assert before in text
    (copy / file).write_text(text.replace(before, after))
    with pytest.raises(RoundError, match=words):
        verify_round(copy, 1)


def test_a_round_of_another_generator_says_so(opened, monkeypatch, tmp_path) -> None:
    """Another generator reads the draw as other scenarios: nobody has changed the round."""
    copy = shutil.copytree(opened / "public" / "first", tmp_path / "first", ignore=shutil.ignore_patterns("results"))
    text = (copy / "opened.json").read_text()
    (copy / "opened.json").write_text(text.replace('"scenario_sha256": "', '"scenario_sha256": "0'))
    monkeypatch.setattr("benchmark.rounds.steps.generator_revision", lambda: "0123456789abcdef")
    with pytest.raises(RoundError, match="this one is 0123456789abcdef"):
        verify_round(copy, 0)


def test_missing_files_are_named(tmp_path) -> None:
    with pytest.raises(RoundError, match=r"opened\.json: cannot be read"):
        verify_round(tmp_path, 0)
    assert "give --solver, or --answers and --name" in " ".join(
        skybench("score", tmp_path, "--secret", "a", "--truth", "b", "--set", "c", code=2).split()
    )
