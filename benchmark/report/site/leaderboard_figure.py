"""The leaderboard as one picture that stands by itself: success of each solver on each task, with its interval."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from markupsafe import Markup, escape

from benchmark.report.formatting import percent
from benchmark.report.site.charts import Style
from benchmark.report.site.site_view import Matrix, MatrixRow, SiteView
from benchmark.stats.intervals import Estimate

_LEAST_WIDTH_PX = 660
_NAME_PX, _CELL_PX, _GAP_PX, _ROW_PX, _HEAD_PX, _FOOT_PX, _EDGE_PX = 168, 96, 24, 34, 62, 54, 18
_LIGHT_DARK = re.compile(r"(--[\w-]+):\s*light-dark\((#[0-9a-f]{6}),\s*(#[0-9a-f]{6})\)")


def leaderboard_svg(view: SiteView, palette: str, figure_style: str) -> str:
    """Draw the matrix of successes in the first mode of detections.

    Parameters
    ----------
    view : SiteView
    palette, figure_style : str
        Style sheets of the site, so that the picture looks like it; each colour's light and dark value is taken from
        `palette`.
    """
    matrix = next(matrix for matrix in view.matrices if matrix.key == "success")
    rows = [row for row in matrix.rows if row.detections == view.modes[0]]
    width = max(_EDGE_PX * 2 + _NAME_PX + len(view.tasks) * (_CELL_PX + _GAP_PX), _LEAST_WIDTH_PX)
    height = _HEAD_PX + _ROW_PX * len(rows) + _FOOT_PX
    parts = [*_heads(view, height), *(mark for n, row in enumerate(rows) for mark in _row(matrix, row, n))]
    note = f"Share of frames solved to within 10 km, with 95 % intervals; {view.modes[0]} detections."
    parts.append(_text(_EDGE_PX, height - 14, note, "soft"))
    label = f"Success of {len(rows)} solvers on {len(view.tasks)} tasks"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="panel" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" role="img" aria-label="{escape(label)}"><style>{_style(palette)}{figure_style}'
        f".panel .soft{{fill:var(--soft)}}.panel .head{{font-weight:600}}.wide{{stroke-width:4}}</style>"
        f'<rect width="{width}" height="{height}" fill="var(--paper)"/>{"".join(parts)}</svg>\n'
    )


def _style(palette: str) -> str:
    found: Mapping[str, tuple[str, str]] = {name: (a, b) for name, a, b in _LIGHT_DARK.findall(palette)}
    light = "".join(f"{name}:{a};" for name, (a, _) in found.items())
    dark = "".join(f"{name}:{b};" for name, (_, b) in found.items())
    return f"svg{{{light}}}@media (prefers-color-scheme:dark){{svg{{{dark}}}}}"


def _left(column: int) -> int:
    return _EDGE_PX + _NAME_PX + column * (_CELL_PX + _GAP_PX)


def _heads(view: SiteView, height: int) -> list[str]:
    parts: list[str] = []
    for n, task in enumerate(view.tasks):
        left, base = _left(n), height - _FOOT_PX
        parts.append(_text(left, 28, task.name, "head"))
        parts.append(_text(left, 45, _short(task.condition), "soft"))
        for share, words, anchor in ((0.0, "0", "start"), (0.5, "", "middle"), (1.0, "100 %", "end")):
            u = left + share * _CELL_PX
            parts.append(f'<path class="grid" d="M{u:.1f} {_HEAD_PX - 6}V{base}"/>')
            parts.append(_text(u, base + 15, words, "soft", anchor))
    return parts


def _row(matrix: Matrix, row: MatrixRow, n: int) -> list[str]:
    v = _HEAD_PX + _ROW_PX * (n + 0.5)
    parts: list[str] = [_text(_EDGE_PX, v + 4, _short(row.label, 26), "name")]
    for column, (_, entry) in enumerate(row.cells):
        if entry is None:
            parts.append(_text(_left(column) + _CELL_PX / 2, v + 4, "not run", "soft", "middle"))
            continue
        parts.append(_cell(_left(column), v, entry.success, row.style, f"{row.label}: {percent(entry.success.value)}"))
    return parts


def _cell(left: float, v: float, estimate: Estimate, style: Style, words: str) -> str:
    if math.isnan(estimate.value):
        return ""
    low, value, high = (left + share * _CELL_PX for share in (estimate.low, estimate.value, estimate.high))
    return (
        f'<g class="{style.css}"><path class="whisker wide" d="M{low:.1f} {v:.1f}H{high:.1f}"/>'
        f'<circle class="dot" cx="{value:.1f}" cy="{v:.1f}" r="5"><title>{escape(words)}</title></circle></g>'
    )


def _text(u: float, v: float, words: str, css: str, anchor: str = "start") -> Markup:
    return Markup('<text class="{}" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(css, u, v, anchor, words)


def _short(words: str, most: int = 17) -> str:
    return words if len(words) <= most else f"{words[: most - 1]}…"
