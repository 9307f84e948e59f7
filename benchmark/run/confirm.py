"""Results that stay valid under another revision of the generator: because it renders their frames again, to the byte.

A revision is a digest of code, so that it changes with code that has no part in a task's frames. The frames themselves
decide: where image and truth of each have the SHA-256 that the results state, the results are of today's frames, and say so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import ResultsError
from benchmark.frames.dataset import Frame
from benchmark.frames.frame_set import FrameFacts, FrameSet
from benchmark.frames.identity import FrameIdentity, identity_of
from benchmark.run.identities import identities_in
from benchmark.run.packed import PackedRow, read_packed
from benchmark.run.packing import write_packed
from benchmark.run.provenance import read_provenance, result_key


@dataclass(frozen=True)
class Confirmed:
    """Packed results that were held against frames rendered today.

    Attributes
    ----------
    listing : Path
    n_frames : int
    solvers : tuple of str
        Whose results were of another revision's frames, and now are of today's.
    """

    listing: Path
    n_frames: int
    solvers: tuple[str, ...]


def confirm(root: Path, today: FrameSet) -> Confirmed:
    """Hold packed results against all frames of a task, and let those that are of the same frames say so.

    Parameters
    ----------
    root : Path
        Of the results.
    today : FrameSet
        All frames of the results' task and split, as today's generator renders them.

    Raises
    ------
    ResultsError
        There are no packed results; they are of other frames, state no hashes, or are of another definition of the task.
        Nothing is changed then.
    """
    listing = root / today.facts.place.with_name(f"{today.facts.place.name}.json")
    if not listing.is_file():
        raise ResultsError(f"{listing}: there are no packed results; pack them with skybench bench pack-results")
    rows = read_packed(listing)
    older = [row for row in rows if row.provenance["frames"]["scenario_sha256"] != today.facts.scenario_sha256]
    if older:
        _check(listing, older, today.frames)
        write_packed(listing, [_confirmed(listing, row, today.facts) if row in older else row for row in rows])
    return Confirmed(listing, len(today.frames), tuple(row.solver for row in older))


def _check(listing: Path, rows: Sequence[PackedRow], frames: Sequence[Frame]) -> None:
    """Refuse results that are not of these frames."""
    here = {frame.frame_id: identity_of(frame) for frame in frames}
    for row in rows:
        stated = identities_in(row.frames)
        if missing := sorted(stated.keys() - here.keys()):
            raise ResultsError(
                f"{listing}: {row.solver} has {missing[0]}, which the task does not have today; run it again"
            )
        for name, identity in stated.items():
            if identity.image_sha256 is None or identity.truth_sha256 is None:
                raise ResultsError(f"{listing}: {row.solver} states no hashes of {name}; run it again")
            if identity != here[name]:
                raise ResultsError(
                    f"{listing}: {name} of {row.solver} is not what the generator renders today "
                    f"({_differs(identity, here[name])}); run it again with skybench bench boards"
                )


def _differs(stated: FrameIdentity, here: FrameIdentity) -> str:
    parts = [
        name
        for name, same in (
            ("image", stated.image_sha256 == here.image_sha256),
            ("truth", stated.truth_sha256 == here.truth_sha256),
        )
        if not same
    ]
    return f"another {' and '.join(parts)}"


def _confirmed(listing: Path, row: PackedRow, today: FrameFacts) -> PackedRow:
    source = read_provenance(row.provenance)
    if source.frames.definition_sha256 != today.definition_sha256:
        raise ResultsError(
            f"{listing}: {row.solver} is of another definition of {today.label}; run it again with skybench bench boards"
        )
    frames = dataclasses.replace(
        source.frames, scenario_sha256=today.scenario_sha256, rendered_again_with=today.rendered_with
    )
    key = result_key(row.solver, source.solver, frames)
    changed = dataclasses.replace(source, frames=frames, key=key)
    return dataclasses.replace(row, key=key, provenance=dataclasses.asdict(changed))
