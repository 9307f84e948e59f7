"""The four steps of a round: commit, pack, score, open; and the verification that anyone can make of an opened round."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.errors import RoundError
from benchmark.frames.dataset import Frame
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.identity import FrameIdentity
from benchmark.provenance import now_utc
from benchmark.rounds.commitment import (
    COMMITMENT,
    OPENED,
    PACKED,
    Commitment,
    Terms,
    check_secret,
    json_bytes,
    key_of,
    read_commitment,
    read_json,
    write_commitment,
)
from benchmark.rounds.drawing import DrawnFrame, draw_frames
from benchmark.rounds.private_frames import check_different, frame_set, read_frames, render_frames
from benchmark.rounds.rules import Rules
from benchmark.rounds.secret import RoundKey
from benchmark.submit.pack import LISTING, pack
from generator import __version__
from generator.files import write_bytes
from generator.identity.revision import generator_revision

PACKED_FORMAT, OPENED_FORMAT = "skybench-round-set/1", "skybench-round-opened/1"
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Drawn:
    """A round whose secret is available.

    Attributes
    ----------
    commitment : Commitment
    rules : Rules
    key : RoundKey
    frames : tuple of DrawnFrame
    """

    commitment: Commitment
    rules: Rules
    key: RoundKey
    frames: tuple[DrawnFrame, ...]


def commit(
    folder: Path, secret: bytes, rules: Rules, name: str, frames: int, contestants: Mapping[str, str], beacon: str = ""
) -> Commitment:
    """Write what is published before any frame is drawn.

    Raises
    ------
    RoundError
        The folder contains a commitment already, or frames cannot be drawn by the rules.
    """
    terms = Terms(
        name=name,
        frames=frames,
        date_utc=now_utc(),
        rules_sha256=rules.sha256,
        skybench=__version__,
        generator_revision=generator_revision(),
        contestants=dict(sorted(contestants.items())),
        beacon=beacon,
    )
    # Trial draw with the numbers of another secret, to find rules that cannot be drawn before committing to them.
    draw_frames(
        rules, RoundKey.of(hashlib.sha256(rules.text.encode()).digest()[:16], rules.sha256, ""), min(frames, 20)
    )
    return write_commitment(folder, secret, terms, rules)


def draw(folder: Path, secret: bytes, beacon: str = "") -> Drawn:
    """Draw a round's frames from its secret.

    Raises
    ------
    RoundError
        The secret is not the one that was committed to.
    """
    found, rules = read_commitment(folder)
    check_secret(found, secret)
    key = key_of(found, secret, beacon)
    return Drawn(found, rules, key, draw_frames(rules, key, found.terms.frames))


def pack_round(
    folder: Path, drawn: Drawn, truth: Path, out: Path, jobs: int, progress: Progress = lambda frames: None
) -> int:
    """Render the frames into a private folder, write the set for solvers, and publish the hash of the set.

    Parameters
    ----------
    folder : Path
        Folder of the round, which is published.
    drawn : Drawn
    truth, out : Path
        Private folder of the frames with their truth, and folder of the set; neither may contain the other.
    jobs : int
    progress : callable

    Returns
    -------
    int
        Number of frames.

    Raises
    ------
    RoundError
        A folder is inside another, or the generator is not the one that was committed to.
    """
    check_apart(truth, {"the set": out, "the round": folder})
    check_apart(out, {"the truth": truth})
    check_generator(drawn.commitment.terms)
    render_frames(drawn.frames, truth, jobs, progress)
    frames = read_frames(drawn.frames, truth, drawn.key)
    check_different(frames)
    content = {
        "format": PACKED_FORMAT,
        "commitment_sha256": drawn.commitment.sha256,
        "frames": len(frames),
        "set_sha256": _write_set(frames, out),
    }
    write_bytes(folder / PACKED, json_bytes(content))
    return len(frames)


def _write_set(frames: Sequence[Frame], out: Path) -> str:
    """Write the set for solvers, and return its hash."""
    pack(frames, out, names={frame.frame_id: frame.frame_id for frame in frames})
    return set_sha256(out)


def check_apart(inner: Path, others: Mapping[str, Path]) -> None:
    """Refuse nested folders, in which a solver could walk from images to truth. Raises RoundError."""
    mine = inner.resolve()
    for name, other in others.items():
        theirs = other.resolve()
        if mine.is_relative_to(theirs) or theirs.is_relative_to(mine):
            raise RoundError(
                f"{inner} and {name} {other}: one lies in the other; keep images and truth in folders apart"
            )


def check_generator(terms: Terms) -> None:
    """Refuse to render with a generator other than the one that was committed to. Raises RoundError."""
    if generator_revision() != terms.generator_revision:
        raise RoundError(
            f"round {terms.name}: was committed to with the generator's revision {terms.generator_revision} (skybench "
            f"{terms.skybench}), this one is {generator_revision()}; install that one"
        )


def set_sha256(folder: Path) -> str:
    """Hash of a set: names and contents of all its images and records, in the order of the names.

    Raises
    ------
    RoundError
        A file is missing.
    """
    digest = hashlib.sha256()
    try:
        for entry in json.loads((folder / LISTING).read_text(encoding="utf-8")):
            for suffix in ("png", "json"):
                place = f"{entry['frame_id']}.{suffix}"
                digest.update(f"{place}:{hashlib.sha256((folder / place).read_bytes()).hexdigest()};".encode())
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RoundError(f"{folder}: is no whole set ({error}); make it with `skybench bench round pack`") from error
    return digest.hexdigest()


def published_set(folder: Path, drawn: Drawn) -> str:
    """Hash of the set that was published for solvers.

    Raises
    ------
    RoundError
        It is of another commitment, or of another number of frames.
    """
    path = folder / PACKED
    published = read_json(path)
    if published.get("commitment_sha256") != drawn.commitment.sha256:
        raise RoundError(f"{path}: belongs to another commitment than {folder / COMMITMENT}")
    if published.get("frames") != len(drawn.frames):
        raise RoundError(f"{path}: states {published.get('frames')} frames, {COMMITMENT} {len(drawn.frames)}")
    return str(published.get("set_sha256"))


def frames_to_score(folder: Path, drawn: Drawn, truth: Path, packed: Path, later: bool) -> FrameSet:
    """Frames for solvers: images and circumstances from the set, truth from the private folder.

    Raises
    ------
    RoundError
        The set is not the one whose hash was published.
    """
    if published_set(folder, drawn) != set_sha256(packed):
        raise RoundError(f"{packed}: is not the set that {folder / PACKED} states (another SHA-256); restore it")
    frames = read_frames(drawn.frames, truth, drawn.key)
    # Images are taken from the folder that holds no truth.
    shown = [dataclasses.replace(frame, image_path=packed / f"{frame.frame_id}.png") for frame in frames]
    return frame_set(drawn.commitment, drawn.frames, shown, later)


def check_frozen(terms: Terms, revisions: Mapping[str, str | None]) -> None:
    """Refuse solvers that have changed since the round was committed to. Raises RoundError."""
    for name, revision in revisions.items():
        settled = terms.contestants.get(name)
        if settled is None or settled != revision:
            what = f"revision {settled} was committed to" if settled else "was not committed to"
            raise RoundError(
                f"{name}: {what}, this one is {revision or 'of no known revision'}; install the committed one, or run "
                "it with --later, apart from those that were settled before the frames were drawn"
            )


def open_round(folder: Path, secret: bytes, drawn: Drawn, truth: Path, beacon: str) -> Path:
    """Publish the secret and what it draws.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    RoundError
        The frames are not available as they were drawn.
    """
    frames = read_frames(drawn.frames, truth, drawn.key)
    identities = check_different(frames)
    content = {
        "format": OPENED_FORMAT,
        "commitment_sha256": drawn.commitment.sha256,
        "secret": secret.hex(),
        "beacon": beacon,
        "frames": [_opened_frame(one, identities[one.name]) for one in drawn.frames],
    }
    path = folder / OPENED
    write_bytes(path, json_bytes(content))
    return path


def _opened_frame(drawn: DrawnFrame, identity: FrameIdentity) -> dict[str, Any]:
    return {
        "name": drawn.name,
        "kind": drawn.kind,
        "scenario_sha256": drawn.scenario.content_sha256,
        "image_sha256": identity.image_sha256,
        "truth_sha256": identity.truth_sha256,
    }


@dataclass(frozen=True)
class Verified:
    """What the verification of an opened round has confirmed.

    Attributes
    ----------
    frames : int
        Number of scenarios that were drawn again.
    rendered : int
        Number of frames that were rendered again, with the same image and truth.
    whole_set : bool
        Whether these were all frames, and make the set for solvers whose hash was published.
    """

    frames: int
    rendered: int
    whole_set: bool


def verify_round(folder: Path, render: int, progress: Progress = lambda frames: None) -> Verified:
    """Draw an opened round again from its secret, and render some of its frames again.

    Parameters
    ----------
    folder : Path
        Folder of the round, without anything private.
    render : int
        Number of frames to render, spread evenly; 0 for none. All of them must also make the set for solvers.
    progress : callable

    Raises
    ------
    RoundError
        Something differs from what was published.
    """
    path = folder / OPENED
    opened = read_json(path)
    if opened.get("format") != OPENED_FORMAT:
        raise RoundError(f"{path}: is not of the format {OPENED_FORMAT}")
    secret, beacon, listed = opened.get("secret"), opened.get("beacon"), opened.get("frames")
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
        raise RoundError(f"{path}: frames must be a list of objects")
    if not isinstance(secret, str) or not isinstance(beacon, str):
        raise RoundError(f"{path}: needs the texts secret and beacon")
    try:
        drawn = draw(folder, bytes.fromhex(secret), beacon)
    except ValueError as error:
        raise RoundError(f"{path}: secret is not hexadecimal") from error
    scenarios = [(one.name, one.kind, one.scenario.content_sha256) for one in drawn.frames]
    if scenarios != [(one.get("name"), one.get("kind"), one.get("scenario_sha256")) for one in listed]:
        # Another generator may read the same draw as another scenario, with a key more or another value of a preset.
        check_generator(drawn.commitment.terms)
        raise RoundError(f"{path}: lists other frames than its secret draws")
    published = published_set(folder, drawn)
    n_chosen = min(render, len(drawn.frames))
    chosen = [drawn.frames[i * len(drawn.frames) // n_chosen] for i in range(n_chosen)]
    whole = n_chosen == len(drawn.frames)
    if chosen:
        check_generator(drawn.commitment.terms)
        with tempfile.TemporaryDirectory(prefix="skybench-round-") as scratch:
            truth, packed = Path(scratch) / "truth", Path(scratch) / "set"
            render_frames(chosen, truth, 1, progress)
            frames = read_frames(chosen, truth, drawn.key)
            made = check_different(frames)
            remade = _write_set(frames, packed) if whole else published
        stated = {one["name"]: FrameIdentity(one.get("image_sha256"), one.get("truth_sha256")) for one in listed}
        for name, identity in made.items():
            if stated[name] != identity:
                raise RoundError(
                    f"{path}: frame {name} is another one when it is rendered again (another SHA-256); "
                    "skybench doctor says whether this machine computes as most do"
                )
        if remade != published:
            raise RoundError(f"{folder / PACKED}: states another SHA-256 than that of the set which the frames make")
    return Verified(len(scenarios), len(chosen), whole)
