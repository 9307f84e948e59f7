"""Results that stay valid under another revision of the generator, because it renders the same frames to the byte.

A revision is a digest of code, so it also changes with code that does not affect a task's frames. The frames themselves
decide: where image and truth of each frame have the SHA-256 that the results state, the results hold for today's frames, are
marked accordingly, and get the circumstances that today's records state.

The same is done for results of a task that has gained conditions since, once results of the new conditions alone complete
them.

Where some frames differ, `benchmark.run.renewal` keeps the answers to the others.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from benchmark.errors import ResultsError
from benchmark.frames.dataset import Frame
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.identity import FrameIdentity, identity_of
from benchmark.run.completed import completed, remove_used, results_alone
from benchmark.run.identities import identities_in
from benchmark.run.packed import PackedRow, read_packed
from benchmark.run.packing import write_packed
from benchmark.run.provenance import read_provenance, result_key
from benchmark.run.result_tables import condition_values


@dataclass(frozen=True)
class Confirmed:
    """Packed results that were compared with frames rendered today.

    Attributes
    ----------
    listing : Path
    n_frames : int
    solvers : tuple of str
        Solvers whose results were of another revision's frames, and now are of today's.
    lacking : tuple of str
        Solvers whose results lack conditions that the task has gained; these results stay as they were.
    """

    listing: Path
    n_frames: int
    solvers: tuple[str, ...]
    lacking: tuple[str, ...] = ()


def packed_listing(root: Path, place: Path) -> Path:
    """Path of the listing of packed results, for frames named like ``bortle@2/dev``.

    Raises
    ------
    ResultsError
        There is no such listing.
    """
    listing = root / place.with_name(f"{place.name}.json")
    if not listing.is_file():
        raise ResultsError(f"{listing}: there are no packed results; pack them with skybench bench pack-results")
    return listing


def confirm(root: Path, today: FrameSet, earlier: Mapping[str, int] | None = None) -> Confirmed:
    """Compare packed results with all frames of a task, and mark those that are of the same frames.

    Parameters
    ----------
    root : Path
        Root folder of the results.
    today : FrameSet
        All frames of the task and split of the results, as today's generator renders them.
    earlier : mapping of str to int, optional
        Hashes of the task's definition before it gained conditions, each with the number of conditions at that time
        (`benchmark.tasks.appended.earlier_definitions`).

    Raises
    ------
    ResultsError
        There are no packed results, or they are of other frames, state no hashes, or are of another definition of the task.
        Nothing is changed in these cases.
    """
    listing = packed_listing(root, today.facts.place)
    rows = read_packed(listing)
    older: dict[int, PackedRow] = {}
    lacking: list[str] = []
    kept: list[PackedRow] = []
    used: defaultdict[Path, list[PackedRow]] = defaultdict(list)
    for row in rows:
        facts = row.provenance["frames"]
        if facts["scenario_sha256"] == today.facts.scenario_sha256:
            kept.append(row)
            continue
        whole = row
        if (count := (earlier or {}).get(facts["definition_sha256"])) is not None and today.facts.grading is not None:
            alone = results_alone(root, row, today.facts, today.facts.grading.values[count:])
            if alone is None:
                lacking.append(row.solver)
                kept.append(row)
                continue
            whole = completed(row, list(alone.values()), today.facts)
            for place, one in alone.items():
                used[place].append(one)
        older[len(kept)] = whole
        kept.append(whole)
    if older:
        _check(listing, older.values(), today.frames)
        for number, whole in older.items():
            kept[number] = _confirmed(listing, whole, today)
        write_packed(listing, kept)
        remove_used(used)
    return Confirmed(listing, len(today.frames), tuple(row.solver for row in older.values()), tuple(lacking))


def _check(listing: Path, rows: Iterable[PackedRow], frames: Sequence[Frame]) -> None:
    """Raise an error for results that are not of these frames."""
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
                    f"({_differs(identity, here[name])}); skybench bench boards solves the frames that differ again"
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


def _confirmed(listing: Path, row: PackedRow, today: FrameSet) -> PackedRow:
    facts, source = today.facts, read_provenance(row.provenance)
    if source.frames.definition_sha256 != facts.definition_sha256:
        raise ResultsError(
            f"{listing}: {row.solver} is of another definition of {facts.label}; run it again with skybench bench boards"
        )
    frames = dataclasses.replace(
        source.frames, scenario_sha256=facts.scenario_sha256, rendered_again_with=facts.rendered_with
    )
    key = result_key(row.solver, source.solver, frames)
    changed = dataclasses.replace(source, frames=frames, key=key)
    table = _with_conditions(row.frames, today.frames)
    return dataclasses.replace(row, key=key, provenance=dataclasses.asdict(changed), frames=table)


def _with_conditions(table: pd.DataFrame, frames: Sequence[Frame]) -> pd.DataFrame:
    """Replace circumstances by today's, without which no later result could be packed beside this one."""
    found = pd.DataFrame(
        [condition_values(frame.conditions) for frame in frames], index=[frame.frame_id for frame in frames]
    )
    told = found.reindex(table["frame_id"]).set_index(table.index)
    names = [name for name in found.columns if name in table]
    return table.assign(**{name: told[name].astype(table[name].dtype) for name in names})
