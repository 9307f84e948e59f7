"""Comparison of the frames at hand with the frames that results are of; both are identified by their hashes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.errors import ResultsError
from benchmark.frames.frame_set import FrameFacts
from benchmark.frames.identity import UNKNOWN, FrameIdentity
from benchmark.run.packed import read_packed
from benchmark.run.results import FRAMES_NAME, SUMMARY_NAME, read_summary, read_table

IDENTITY_COLUMNS = ("image_sha256", "truth_sha256")
_COLUMNS = ("frame_id", *IDENTITY_COLUMNS)
Recorded = Mapping[str, tuple[FrameIdentity, Path]]
"""Identity of each frame, by its id, and the result that states it."""


def recorded_identities(out: Path, facts: FrameFacts) -> Recorded:
    """Identities of frames by id, as stated by results on frames of the same scenario, each with the result that states it.

    Parameters
    ----------
    out : Path
        Root of all results, raw or packed.
    facts : FrameFacts

    Raises
    ------
    ResultsError
        A result is damaged.
    """
    found: dict[str, tuple[FrameIdentity, Path]] = {}
    for place, table in _tables(out, facts):
        if set(_COLUMNS) <= set(table.columns):
            for frame_id, identity in identities_in(table).items():
                found.setdefault(frame_id, (identity, place))
    return found


def identities_in(frames: pd.DataFrame) -> dict[str, FrameIdentity]:
    """Identities that the table of frames of a result states; in a table without hashes they are unknown."""
    if not set(IDENTITY_COLUMNS) <= set(frames.columns):
        return dict.fromkeys(frames["frame_id"], UNKNOWN)
    listed = frames[list(_COLUMNS)].itertuples(index=False)
    return {frame_id: FrameIdentity(_text(image), _text(truth)) for frame_id, image, truth in listed}


def check_identity(frame_id: str, here: FrameIdentity, recorded: Recorded) -> None:
    """Check that a frame is the one that results are of. Raises ResultsError."""
    stated, place = recorded.get(frame_id, (UNKNOWN, Path()))
    if stated.contradicts(here):
        part = "image" if stated.image_sha256 != here.image_sha256 else "truth"
        raise ResultsError(
            f"{frame_id}: its {part} is not the one that {place} is of (another SHA-256); "
            "restore the frame, or give another --out for results on these frames; skybench doctor says whether this "
            "machine computes as most do"
        )


def _tables(out: Path, facts: FrameFacts) -> Iterator[tuple[Path, pd.DataFrame]]:
    """Yield the tables of results on frames of the same scenario, each with its path."""
    for summary in sorted((out / facts.place).glob(f"*/*/{SUMMARY_NAME}")):
        if read_summary(summary).provenance.frames.scenario_sha256 == facts.scenario_sha256:
            yield summary.parent, read_table(summary.with_name(FRAMES_NAME), _COLUMNS).to_pandas()
    listing = out / facts.place.with_name(f"{facts.place.name}.json")
    if listing.is_file():
        for row in read_packed(listing):
            frames: Any = row.provenance.get("frames")
            if isinstance(frames, Mapping) and frames.get("scenario_sha256") == facts.scenario_sha256:
                yield listing, row.frames


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None
