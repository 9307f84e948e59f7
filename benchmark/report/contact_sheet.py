"""Pictures of frames with detections and identified stars drawn over them."""

import base64
import io
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from benchmark.errors import ResultsError
from benchmark.frames.preview import encode_webp
from benchmark.report.formatting import number
from benchmark.run.result_tables import DetectionRow
from benchmark.run.results import PREVIEW_FOLDER, SolverResult
from benchmark.stats.metrics import FrameScore

MAX_FRAMES = 60
IMAGE_BUDGET_BYTES = 3_500_000
_WIDTHS_PX = (1080, 900, 720, 540, 400, 280)


@dataclass(frozen=True)
class Overlay:
    """What one solver made of a frame, as SVG path data in the frame's pixels, and in words."""

    solver: str
    number: int
    unmatched: str
    correct: str
    wrong: str
    result: str
    counts: str


@dataclass(frozen=True)
class Card:
    """One frame of the sheet; `view_box` covers the image from edge to edge, pixel centres being at integers."""

    frame_id: str
    bortle: str
    image_uri: str
    width_px: int
    height_px: int
    view_box: str
    overlays: tuple[Overlay, ...]


def make_cards(out: Path, results: Sequence[SolverResult]) -> list[Card]:
    """Cards of at most `MAX_FRAMES` frames, evenly spread over the dataset, with pictures within the size budget.

    Raises
    ------
    ResultsError
        A frame's preview picture is missing or damaged.
    """
    scores = _spread(results[0].scores)
    pictures = _fit([_preview(out, score.frame_id) for score in scores])
    drawn = [(result, _by_frame(result)) for result in results]
    return [_card(score, picture, drawn) for score, picture in zip(scores, pictures, strict=True)]


def _spread(scores: Sequence[FrameScore]) -> list[FrameScore]:
    if len(scores) <= MAX_FRAMES:
        return list(scores)
    return [scores[n * len(scores) // MAX_FRAMES] for n in range(MAX_FRAMES)]


def _preview(out: Path, frame_id: str) -> bytes:
    path = out / PREVIEW_FOLDER / f"{Path(frame_id).name}.webp"
    try:
        return path.read_bytes()
    except OSError as error:
        raise ResultsError(f"{path}: missing preview picture; run `skybench bench run` again") from error


def _fit(pictures: Sequence[bytes]) -> list[bytes]:
    """Reduce pictures until base64 of all of them fits the budget, or to the least width."""
    fitted = list(pictures)
    for width in _WIDTHS_PX:
        if sum(len(picture) for picture in fitted) * 4 // 3 <= IMAGE_BUDGET_BYTES:
            break
        fitted = []
        for picture in pictures:
            with Image.open(io.BytesIO(picture), formats=["WEBP"]) as opened:
                fitted.append(encode_webp(opened.convert("L"), width))
    return fitted


def _by_frame(result: SolverResult) -> Mapping[str, list[DetectionRow]]:
    rows: defaultdict[str, list[DetectionRow]] = defaultdict(list)
    for row in result.detections:
        rows[row.frame_id].append(row)
    return rows


def _card(
    score: FrameScore, picture: bytes, drawn: Sequence[tuple[SolverResult, Mapping[str, list[DetectionRow]]]]
) -> Card:
    overlays = []
    for n, (result, rows_of) in enumerate(drawn):
        mine = next(other for other in result.scores if other.frame_id == score.frame_id)
        overlays.append(_overlay(n, result.solver, mine, rows_of.get(score.frame_id, [])))
    return Card(
        frame_id=score.frame_id,
        bortle="no class" if score.bortle is None else f"Bortle {score.bortle}",
        image_uri="data:image/webp;base64," + base64.b64encode(picture).decode("ascii"),
        width_px=score.width_px,
        height_px=score.height_px,
        view_box=f"-0.5 -0.5 {score.width_px} {score.height_px}",
        overlays=tuple(overlays),
    )


def _overlay(n: int, solver: str, score: FrameScore, rows: Sequence[DetectionRow]) -> Overlay:
    radius = max(score.width_px / 110.0, 2.5)
    result = f"{number(score.error_km)} km" if math.isfinite(score.error_km) else f"{score.status}: {score.reason}"
    if score.reason.startswith(f"{score.status}:"):
        result = score.reason
    return Overlay(
        solver=solver,
        number=n,
        unmatched="".join(_circle(row, 0.6 * radius) for row in rows if row.star_id is None),
        correct="".join(_circle(row, radius) for row in rows if row.correct),
        wrong="".join(_cross(row, radius) for row in rows if row.star_id is not None and not row.correct),
        result=result,
        counts=f"{score.n_correct} of {score.n_matches} identifications correct, {score.n_detections} detections",
    )


def _circle(row: DetectionRow, radius: float) -> str:
    r, d = f"{radius:.1f}", f"{2.0 * radius:.1f}"
    return f"M{row.u_px - radius:.1f} {row.v_px:.1f}a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0"


def _cross(row: DetectionRow, radius: float) -> str:
    d = f"{2.0 * radius:.1f}"
    u, v = row.u_px - radius, row.v_px - radius
    return f"M{u:.1f} {v:.1f}l{d} {d}m0 -{d}l-{d} {d}"
