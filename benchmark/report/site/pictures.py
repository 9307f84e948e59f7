"""Picture files of frames next to the pages, and drawings of each solver's answer to be overlaid on them."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.errors import ResultsError
from benchmark.judge.outcome import DetectionRow
from benchmark.report.overlay import Overlay, draw_overlay
from benchmark.report.site.boards import Board, Entry
from benchmark.report.site.failures import Failure, pictured_frames
from benchmark.report.site.frame_source import FrameSource
from generator.errors import GeneratorError
from generator.files import path_within, write_bytes

PICTURES_FOLDER = "pictures"
MOST_PICTURES = 100
"""Default number of pictures per board."""
PICTURE_WIDTH_PX = 640
_STROKES = 'fill="none" stroke-linecap="round" stroke-width'
_COLOURS = {"truth": "#f2d34e", "found": "#b9c6d6", "right": "#2fe0a6", "wrong": "#ff8247"}
"""Colours as in the pages' style sheet."""


@dataclass(frozen=True)
class Pictures:
    """Files of a board's pictures, as paths relative to the pages.

    Attributes
    ----------
    frames : dict of str to str
        By the id of the frame.
    overlays : dict of (int, str) to str
        By the index of the solver on the board and the id of the frame.
    at_hand : bool
        Whether the frames are available at all.
    """

    frames: dict[str, str] = field(default_factory=dict)
    overlays: dict[tuple[int, str], str] = field(default_factory=dict)
    at_hand: bool = False


@dataclass(frozen=True)
class Card:
    """One solver's worst frame and its answer there; `overlay` is None where its detections are not available."""

    anchor: str
    label: str
    frame_id: str
    condition: float
    words: str
    counts: str
    image: str
    overlay: str | None
    width_px: int
    height_px: int


def write_pictures(
    board: Board, failures: Sequence[Failure], source: FrameSource, site: Path, most: int = MOST_PICTURES
) -> Pictures:
    """Write the pictures of the worst failures, and an overlay for each solver that failed on one.

    Parameters
    ----------
    board : Board
    failures : sequence of Failure
        All failures of the board.
    source : FrameSource
    site : Path
        Folder of the pages.
    most : int
        Largest number of pictures.

    Raises
    ------
    ResultsError
        A picture or a table is damaged, or its name leads out of the folder.
    """
    stored = board.entries[0].stored
    images = Path(PICTURES_FOLDER) / f"{board.task.key}-{board.split}"
    frames: dict[str, str] = {}
    chosen = pictured_frames(board, failures, most)
    for frame_id in chosen:
        place = images / f"{frame_id}.webp"
        picture = source.picture(stored, frame_id, PICTURE_WIDTH_PX)
        if picture is None:
            return Pictures()
        write_into(site, place.as_posix(), picture)
        frames[frame_id] = place.as_posix()
    stars = source.true_stars(stored, chosen)
    overlays: dict[tuple[int, str], str] = {}
    for place, mine in itertools.groupby(failures, key=lambda failure: failure.entry):
        entry = board.entries[place]
        ids = [failure.frame_id for failure in mine if failure.frame_id in set(chosen)]
        folder = images.with_name(f"{images.name}-{board.detections}")
        name = re.sub(r"[^A-Za-z0-9._+-]", "-", entry.label)
        for frame_id, rows in entry.stored.detections_in(ids).items():
            path = (folder / f"{frame_id}-{name}.svg").as_posix()
            write_into(site, path, _svg(_overlay(entry, frame_id, rows, stars.get(frame_id, ()))).encode())
            overlays[(place, frame_id)] = path
    return Pictures(frames, overlays, at_hand=True)


def write_into(site: Path, place: str, content: bytes) -> None:
    """Write a file into the folder of the pages. Raises ResultsError where its name leads out of it."""
    try:
        path = path_within(site, place)
    except GeneratorError as error:
        raise ResultsError(str(error)) from error
    write_bytes(path, content)


def worst_cards(board: Board, pictures: Pictures) -> list[Card]:
    """Each solver's worst frame, where there is a picture of it."""
    cards = []
    for place, entry in enumerate(board.entries):
        worst = entry.worst
        image = pictures.frames.get(worst.frame_id) if worst else None
        if worst is None or image is None:
            continue
        frames = entry.stored.frames
        row = frames[frames["frame_id"] == worst.frame_id].iloc[0]
        matches = int(row["n_matches"])
        named = f"{int(row['n_correct'])} of {matches} stars named right" if matches else "no star named"
        cards.append(
            Card(
                anchor=f"worst-{place}",
                label=entry.label,
                frame_id=worst.frame_id,
                condition=worst.condition,
                words=worst.words,
                counts=f"{named}, {int(row['n_detections'])} detections",
                image=image,
                overlay=pictures.overlays.get((place, worst.frame_id)),
                width_px=int(row["width_px"]),
                height_px=int(row["height_px"]),
            )
        )
    return cards


def _overlay(
    entry: Entry, frame_id: str, rows: Sequence[DetectionRow], stars: Sequence[tuple[float, float]]
) -> Overlay:
    frames = entry.stored.frames
    row = frames[frames["frame_id"] == frame_id].iloc[0]
    return draw_overlay(int(row["width_px"]), int(row["height_px"]), rows, stars)


def remove_others(site: Path, kept: Sequence[Pictures]) -> None:
    """Remove pictures left by an earlier report."""
    places = {place for one in kept for place in (*one.frames.values(), *one.overlays.values())}
    for path in sorted((site / PICTURES_FOLDER).glob("*/*")):
        if path.relative_to(site).as_posix() not in places:
            path.unlink()
    for folder in sorted((site / PICTURES_FOLDER).glob("*")):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _svg(overlay: Overlay) -> str:
    """An overlay as a separate file: it is shown on the picture, which is dark in both themes."""
    paths = "".join(
        f'<path stroke="{colour}" {_STROKES}="{overlay.dot_px if name == "found" else overlay.stroke_px}" d="{marks}"/>'
        for name, colour in _COLOURS.items()
        if (marks := getattr(overlay, name))
    )
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{overlay.view_box}">{paths}</svg>\n'
