"""The gallery of a board: each solver's worst frame, with what it made of it drawn over the picture."""

from __future__ import annotations

import base64
import dataclasses
import io
from dataclasses import dataclass

from PIL import Image, UnidentifiedImageError

from benchmark.errors import ResultsError
from benchmark.frames.preview import encode_webp
from benchmark.report.overlay import Overlay, draw_overlay
from benchmark.report.site.boards import Board, Entry
from benchmark.report.site.frame_source import FrameSource

# Of a card's words and tags in the page.
_CARD_BYTES = 1200
_LEAST_CARD_BYTES = 9_000
_FEWEST_CARDS = 3
_WIDTHS_PX = (720, 540, 400, 300, 220)


@dataclass(frozen=True)
class Card:
    """One solver's worst frame and what it made of it."""

    anchor: str
    label: str
    frame_id: str
    condition: float
    words: str
    counts: str
    image_uri: str
    width_px: int
    height_px: int
    overlay: Overlay


def make_cards(board: Board, source: FrameSource, budget_bytes: int) -> list[Card]:
    """Cards of the solvers whose worst frame has a picture at hand.

    Parameters
    ----------
    board : Board
    source : FrameSource
    budget_bytes : int
        What all cards together may add to a page; where it is too little, pictures have the least width.

    Raises
    ------
    ResultsError
        A picture or a table of detections is damaged.
    """
    shown = []
    for number, entry in enumerate(board.entries):
        picture = source.picture(entry.stored, entry.worst.frame_id) if entry.worst else None
        if picture is not None:
            shown.append((number, entry, picture))
    # Fewer pictures rather than ones too small to show anything; the best solvers' first.
    shown = shown[: max(_FEWEST_CARDS, budget_bytes // _LEAST_CARD_BYTES)]
    cards = []
    for number, entry, picture in shown:
        try:
            bare = _card(entry, source, number)
            fitted = _fit(picture, budget_bytes // len(shown) - bare.overlay.size - _CARD_BYTES)
        except (UnidentifiedImageError, OSError) as error:
            raise ResultsError(
                f"{entry.stored.folder}: the picture of a frame is not readable ({error}); run `skybench bench run` again"
            ) from error
        cards.append(dataclasses.replace(bare, image_uri=_uri(fitted)))
    return cards


def _fit(picture: bytes, most_bytes: int) -> bytes:
    """Reduce a picture until its base64 has at most so many bytes, or to the least width."""
    with Image.open(io.BytesIO(picture), formats=["WEBP"]) as opened:
        grey = opened.convert("L")
    fitted = b""
    for width in _WIDTHS_PX:
        fitted = encode_webp(grey, width)
        if len(fitted) * 4 // 3 <= most_bytes:
            break
    return fitted


def _card(entry: Entry, source: FrameSource, number: int) -> Card:
    worst = entry.worst
    assert worst is not None
    frames = entry.stored.frames
    row = frames[frames["frame_id"] == worst.frame_id].iloc[0]
    width, height = int(row["width_px"]), int(row["height_px"])
    rows = entry.stored.detections_of(worst.frame_id)
    return Card(
        anchor=f"worst-{number}",
        label=entry.label,
        frame_id=worst.frame_id,
        condition=worst.condition,
        words=worst.words,
        counts=_counts(int(row["n_correct"]), int(row["n_matches"]), int(row["n_detections"])),
        image_uri="",
        width_px=width,
        height_px=height,
        overlay=draw_overlay(width, height, rows, source.true_stars(entry.stored, worst.frame_id)),
    )


def _counts(correct: int, matches: int, detections: int) -> str:
    named = f"{correct} of {matches} stars named right" if matches else "no star named"
    return f"{named}, {detections} detections"


def _uri(picture: bytes) -> str:
    return "data:image/webp;base64," + base64.b64encode(picture).decode("ascii")
