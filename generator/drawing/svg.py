"""Matplotlib's figures as lean SVG for pages, and as standalone pictures.

Matplotlib's own SVG names a style on every element, which a page whose policy forbids inline styles would drop, gives ids
that clash if a page contains several figures, and takes 20 kB for a panel. This backend writes Matplotlib's drawing as
plain elements: text as text, colours of the house style as variables of the page, lengths to a tenth of a pixel, equal
neighbours together, no ids. The same figure gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Affine2D, Transform

from generator.drawing.palette import PALETTE, PAPER
from generator.drawing.style import DPI, FONT_PX, house_style

FONTS = "system-ui,-apple-system,'Segoe UI',Roboto,'Noto Sans',sans-serif"
_NAMES = {one.light: one for one in PALETTE}
_ANCHORS = {"left": "", "center": "middle", "right": "end"}
# Estimates for a line of text in the reader's font, in units of its size: mean advance of a letter, height above the
# lowest point of its letters, depth of that point below the base line.
_ADVANCE, _HEIGHT, _DEPTH = 0.55, 0.93, 0.21
_LETTERS = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C"}

Attributes = tuple[tuple[str, str], ...]
Element = tuple[Attributes, str, str]
"""Attributes that neighbours may share, the tag's own text, and its content."""


def inline_svg(figure: Figure, label: str, behind: str = "") -> str:
    """Write a figure as an element of a page; its colours are those of the page, defined by `palette.palette_sheet`.

    Parameters
    ----------
    figure : Figure
        Figure, drawn at its size in pixels. The gid of an artist becomes its title, which shows under the pointer. Images
        are not supported.
    label : str
        Description of the figure for those who cannot see it.
    behind : str
        Markup drawn before the figure.
    """
    across, down = _size(figure)
    return (
        f'<svg class="panel" viewBox="0 0 {across} {down}" width="{across}" height="{down}" fill="none" '
        f'stroke-linejoin="round" role="img" aria-label="{escape(label)}">{behind}{svg_marks(figure)}</svg>'
    )


def standalone_svg(figure: Figure, label: str, description: str = "") -> str:
    """Write a figure as a file of its own with the house style's background; it adapts to the reader's light or dark setting.

    Parameters
    ----------
    figure : Figure
    label, description : str
        Title and longer description, for those who cannot see it.
    """
    across, down = _size(figure)
    marks = f'<rect width="{across}" height="{down}" fill="{PAPER.light}"/>{svg_marks(figure, named=False)}'
    night = "".join(
        f'[{kind}="{one.light}"]{{{kind}:{one.dark}}}'
        for one in PALETTE
        for kind in ("fill", "stroke")
        if f'{kind}="{one.light}"' in marks
    )
    words = f"<desc>{escape(description)}</desc>" if description else ""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {across} {down}" width="{across}" height="{down}" '
        f'fill="none" stroke-linejoin="round" font-family="{escape(FONTS)}" font-size="{FONT_PX:g}" role="img" '
        f'aria-label="{escape(label)}"><title>{escape(label)}</title>{words}'
        f"<style>@media(prefers-color-scheme:dark){{{night}}}</style>{marks}</svg>\n"
    )


def svg_marks(figure: Figure, named: bool = True) -> str:
    """Elements of a figure, without the enclosing element.

    Parameters
    ----------
    figure : Figure
    named : bool
        Whether colours are the page's variables; otherwise their values for a light page.
    """
    renderer = SvgRenderer(*_size(figure), named)
    with house_style():  # Matplotlib creates ticks only when it draws them
        figure.draw(renderer)
    return renderer.markup()


def _size(figure: Figure) -> tuple[int, int]:
    across, down = figure.get_size_inches() * DPI
    return round(across), round(down)


class SvgRenderer(RendererBase):
    """Matplotlib's renderer interface for writing a figure; `markup` returns the elements."""

    def __init__(self, width: int, height: int, named: bool) -> None:
        super().__init__()
        self.width, self.height, self._named = width, height, named
        self._upright = Affine2D().scale(1.0, -1.0).translate(0.0, height)
        self._titles: list[str] = []
        self._elements: list[Element] = []

    def markup(self) -> str:
        """All elements; neighbours with the same look share a group, and lines among them an element."""
        parts = []
        for attributes, group in groupby(self._elements, key=lambda element: element[0]):
            tags = _joined([(words, inside) for _, words, inside in group], filled="fill" in dict(attributes))
            shared = "".join(f' {name}="{value}"' for name, value in attributes)
            if len(tags) == 1:
                name, rest = tags[0][1:].split(" ", 1)
                parts.append(f"<{name}{shared} {rest}")
            else:
                parts.append(f"<g{shared}>{''.join(tags)}</g>")
        return "".join(parts)

    def get_canvas_width_height(self) -> tuple[float, float]:
        """Size of the drawing, px."""
        return self.width, self.height

    def get_text_width_height_descent(self, s: str, prop: FontProperties, ismath: Any) -> tuple[float, float, float]:
        """Approximate size of a line of text: the reader's font is unknown, and no font of this machine is used."""
        size = prop.get_size_in_points()
        return _ADVANCE * size * len(s), _HEIGHT * size, _DEPTH * size

    def open_group(self, s: str, gid: str | None = None) -> None:
        """Begin an artist."""
        self._titles.append(gid or "")

    def close_group(self, s: str) -> None:
        """End an artist."""
        self._titles.pop()

    def draw_path(
        self,
        gc: GraphicsContextBase,
        path: Path,
        transform: Transform,
        rgbFace: Any = None,
    ) -> None:
        """Draw lines and areas, clipped to the artist's rectangle."""
        attributes = self._look(gc, rgbFace)
        limits = gc.get_clip_rectangle()
        transform = transform + self._upright
        clip = None
        if limits is not None:
            box = limits.transformed(self._upright)
            if rgbFace is None:
                clip = (min(box.x0, box.x1), min(box.y0, box.y1), max(box.x0, box.x1), max(box.y0, box.y1))
            else:
                path, transform = transform.transform_path(path).clip_to_bbox(box), Affine2D()
        outline = _outline(path.iter_segments(transform, clip=clip, simplify=False))
        if attributes and outline:
            self._add(attributes, f'path d="{outline}"')

    def draw_markers(
        self,
        gc: GraphicsContextBase,
        marker_path: Path,
        marker_trans: Transform,
        path: Path,
        trans: Transform,
        rgbFace: Any = None,
    ) -> None:
        """Draw one shape at each point inside the artist's rectangle."""
        attributes = self._look(gc, rgbFace)
        if not attributes:
            return
        limits = gc.get_clip_rectangle()
        points = trans.transform(path.vertices)
        keep = np.isfinite(points).all(axis=1)
        if limits is not None:
            inside = (points >= (limits.x0 - 0.5, limits.y0 - 0.5)) & (points <= (limits.x1 + 0.5, limits.y1 + 0.5))
            keep &= inside.all(axis=1)
        is_circle = np.array_equal(marker_path.vertices, _CIRCLE)
        radius = float(marker_trans.transform((1.0, 0.0))[0] - marker_trans.transform((0.0, 0.0))[0])
        for u, v in self._upright.transform(points[keep]):
            if is_circle:
                self._add(attributes, f'circle cx="{_px(u)}" cy="{_px(v)}" r="{_px(radius, 2)}"')
                continue
            shape = marker_trans + Affine2D().scale(1.0, -1.0).translate(u, v)
            self._add(attributes, f'path d="{_outline(marker_path.iter_segments(shape, simplify=False))}"')

    def draw_text(
        self,
        gc: GraphicsContextBase,
        x: float,
        y: float,
        s: str,
        prop: FontProperties,
        angle: float,
        ismath: Any = False,
        mtext: Text | None = None,
    ) -> None:
        """Draw a line of text as text; its length depends on the reader's font, so it is placed by its own anchor."""
        anchor = ""
        if mtext is not None and (angle == 0 or mtext.get_rotation_mode() == "anchor"):
            u, v = mtext.get_transform().transform(mtext.get_unitless_position())
            v = self.height - v
            turn = np.deg2rad(angle + 90.0)
            up = np.array([np.cos(turn), np.sin(turn)])
            x, y = np.array([u, v]) + float(up @ (x - u, y - v)) * up
            anchor = _ANCHORS[mtext.get_horizontalalignment()]
        attributes = [("fill", self._colour(gc.get_rgb()))]
        if anchor:
            attributes.append(("text-anchor", anchor))
        if prop.get_size_in_points() != FONT_PX:
            attributes.append(("font-size", _px(prop.get_size_in_points())))
        if prop.get_weight() not in ("normal", 400):
            attributes.append(("font-weight", "600"))
        turned = f' transform="rotate({-angle:g} {_px(x)} {_px(y)})"' if angle else ""
        self._add(tuple(attributes), f'text x="{_px(x)}" y="{_px(y)}"{turned}', escape(s, quote=False))

    def _add(self, attributes: Attributes, words: str, inside: str = "") -> None:
        title = next((one for one in reversed(self._titles) if one), "")
        if title:
            inside = f"<title>{escape(title, quote=False)}</title>{inside}"
        self._elements.append((attributes, words, inside))

    def _look(self, gc: GraphicsContextBase, face: Any) -> Attributes:
        """Attributes of an outline and its filling; empty if nothing would show."""
        found: list[tuple[str, str]] = []
        forced = gc.get_forced_alpha()
        face_alpha = 0.0 if face is None else gc.get_alpha() if forced or len(face) < 4 else face[3]
        if face_alpha > 0.0:
            found.append(("fill", self._colour(face)))
            found += [("fill-opacity", f"{face_alpha:.2g}")] if face_alpha < 1.0 else []
        rgba, width = gc.get_rgb(), gc.get_linewidth()
        alpha = gc.get_alpha() if forced or len(rgba) < 4 else rgba[3]
        if width > 0.0 and alpha > 0.0:
            found.append(("stroke", self._colour(rgba)))
            found += [("stroke-width", f"{width:.3g}")] if width != 1.0 else []
            found += [("stroke-opacity", f"{alpha:.2g}")] if alpha < 1.0 else []
            dashes = gc.get_dashes()[1]
            if dashes is not None:
                found.append(("stroke-dasharray", " ".join(f"{float(one):g}" for one in np.asarray(dashes))))
        return tuple(found)

    def _colour(self, rgba: Any) -> str:
        value = to_hex((rgba[0], rgba[1], rgba[2]))
        return _NAMES[value].css if self._named and value in _NAMES else value


_CIRCLE = np.asarray(Path.unit_circle().vertices)


def _joined(tags: Sequence[tuple[str, str]], filled: bool) -> list[str]:
    """Join tags as text; neighbouring lines without titles become one path."""
    done: list[str] = []
    open_line = False
    for words, inside in tags:
        line = words.startswith("path ") and not inside and not filled
        if line and open_line:
            done[-1] = f"{done[-1].removesuffix(_PATH_END)}{words.removeprefix(_PATH_START)}/>"
        elif inside:
            done.append(f"<{words}>{inside}</{words.split(' ', 1)[0]}>")
        else:
            done.append(f"<{words}/>")
        open_line = line
    return done


_PATH_START, _PATH_END = 'path d="', '"/>'


def _outline(segments: Iterable[tuple[Any, Any]]) -> str:
    """Path data of Matplotlib's segments."""
    parts, at = [], ["", ""]
    for values, code in segments:
        if code == Path.CLOSEPOLY:
            parts.append("z")
            continue
        numbers = [_px(float(value)) for value in np.asarray(values)]
        if code == Path.LINETO and numbers[1] == at[1]:
            parts.append(f"H{numbers[0]}")
        elif code == Path.LINETO and numbers[0] == at[0]:
            parts.append(f"V{numbers[1]}")
        else:
            parts.append(_LETTERS[code] + " ".join(numbers))
        at = numbers[-2:]
    return "".join(parts)


def _px(value: float, digits: int = 1) -> str:
    """Format a length without trailing zeros."""
    text = f"{value:.{digits}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text
