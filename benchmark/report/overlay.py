"""A solver's answer drawn over the picture of a frame, in the same way on every page that shows frames.

The marks are SVG path data in the frame's pixels, rounded to whole pixels, which is fine enough. A page scales them with the
picture, and its style sheet colours them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from benchmark.judge.outcome import DetectionRow


@dataclass(frozen=True)
class Overlay:
    """Marks over one picture of a frame; a path is empty where there is nothing to mark.

    Attributes
    ----------
    view_box : str
        Covers the picture from edge to edge; pixel centres are at integers.
    stroke_px, dot_px : str
        Widths of lines and of dots, in the frame's pixels.
    truth : str
        Plus signs at true stars.
    found : str
        Dots at detections that were not identified.
    right, wrong : str
        Rings at stars identified correctly, crosses at the others.
    """

    view_box: str
    stroke_px: str
    dot_px: str
    truth: str
    found: str
    right: str
    wrong: str

    @property
    def size(self) -> int:
        """Number of characters in the paths."""
        return len(self.truth) + len(self.found) + len(self.right) + len(self.wrong)


def draw_overlay(
    width_px: int, height_px: int, detections: Sequence[DetectionRow], true_stars: Iterable[tuple[float, float]] = ()
) -> Overlay:
    """Mark detections, identified stars and true stars.

    Parameters
    ----------
    width_px, height_px : int
        Size of the frame.
    detections : sequence of DetectionRow
        The solver's detections in this frame.
    true_stars : iterable of (float, float)
        Positions u, v of true stars, px.
    """
    radius = max(width_px / 90.0, 2.5)
    return Overlay(
        view_box=f"-0.5 -0.5 {width_px} {height_px}",
        stroke_px=f"{max(width_px / 300.0, 1.0):.1f}",
        dot_px=f"{max(width_px / 130.0, 2.0):.1f}",
        truth="".join(_plus(u, v, 0.7 * radius) for u, v in true_stars),
        found="".join(f"M{one.u_px:.0f} {one.v_px:.0f}h.1" for one in detections if one.star_id is None),
        right="".join(_ring(one, radius) for one in detections if one.correct),
        wrong="".join(_cross(one, radius) for one in detections if one.star_id is not None and not one.correct),
    )


def _ring(row: DetectionRow, radius: float) -> str:
    r, d = f"{radius:.0f}", f"{2.0 * round(radius):.0f}"
    return f"M{row.u_px - radius:.0f} {row.v_px:.0f}a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0-{d} 0"


def _plus(u: float, v: float, radius: float) -> str:
    r, d = f"{radius:.0f}", f"{2.0 * round(radius):.0f}"
    return f"M{u - radius:.0f} {v:.0f}h{d}m-{r}-{r}v{d}"


def _cross(row: DetectionRow, radius: float) -> str:
    d = f"{1.6 * radius:.0f}"
    return f"M{row.u_px - 0.8 * radius:.0f} {row.v_px - 0.8 * radius:.0f}l{d} {d}m0-{d}l-{d} {d}"
