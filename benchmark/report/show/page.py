"""The page of a dataset: ``index.html`` and one script per frame, which open from disk without a network.

A page opened from disk may not read files, but it may load scripts. Each frame is therefore a script that passes its pixels
(16 bits, deflated, base64) and its truth to the page when the frame is viewed.
"""

import base64
import json
import shutil
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from numpy.typing import NDArray

from benchmark.frames.preview import preview_webp
from benchmark.report.show.source import Source, open_source
from benchmark.report.show.star_names import star_name
from benchmark.report.templates import read_sheet, render_page
from generator.errors import GeneratorError
from generator.files import write_bytes

PAGE = "index.html"
FRAMES_FOLDER = "frames"
DEFAULT_FRAMES = 48
MOST_PIXELS = 2_200_000
"""Larger frames are averaged over square blocks of pixels."""
MOST_STARS = 4000
"""Number of stars of a frame that the overlay can show, the brightest first."""
THUMBNAIL_PX = 240
BINS = 24
MOST_CHOICES = 40


@dataclass(frozen=True)
class Condition:
    """A condition by which frames are filtered: column of the table of frames, title, unit, and number of decimals."""

    column: str
    title: str
    unit: str = ""
    decimals: int = 1


NUMBERS = (
    Condition("latitude_deg", "latitude", "deg"),
    Condition("longitude_deg", "longitude", "deg"),
    Condition("azimuth_deg", "azimuth of the boresight", "deg", 2),
    Condition("altitude_deg", "altitude of the boresight", "deg", 2),
    Condition("roll_deg", "roll of the camera", "deg", 2),
    Condition("exposure_s", "exposure", "s", 3),
    Condition("zenith_mag_arcsec2", "zenith", "V mag/arcsec²", 2),
    Condition("limiting_magnitude", "faintest star drawn", "V mag", 2),
    Condition("aerosol_tau_550", "aerosol optical depth", "", 3),
    Condition("sun_altitude_deg", "Sun's altitude", "deg"),
    Condition("moon_altitude_deg", "Moon's altitude", "deg"),
    Condition("n_visible", "stars with SNR ≥ 5", "", 0),
    Condition("n_in_field", "catalogue rows", "", 0),
)
CHOICES = (
    Condition("bortle", "Bortle class"),
    Condition("camera_model", "lens model"),
    Condition("split", "split"),
)


@dataclass(frozen=True)
class Written:
    """What was written: the page, frames shown, frames in the dataset, bytes."""

    page: Path
    shown: int
    frames: int
    size: int


def write_page(
    folder: Path,
    out: Path,
    most: int = DEFAULT_FRAMES,
    progress: Callable[[int, int], None] = lambda done, of: None,
    number: int | None = None,
) -> Written:
    """Write the page of a dataset.

    Parameters
    ----------
    folder : Path
        Folder that `skybench generate` or `skybench render` wrote.
    out : Path
        An empty or new folder, or one with an earlier page, which is replaced.
    most : int
        Largest number of frames on the page; from a larger dataset, this many are taken, evenly spread.
    progress : callable
        Called with the number of frames that are done and the total.
    number : int, optional
        For a larger dataset, show consecutive frames instead, `most` per page: those of this page, counted from 1.

    Raises
    ------
    GeneratorError
        The dataset is unfinished or damaged, the folder cannot be used, or there are fewer pages.
    """
    source = open_source(folder, ["utc_mid", *(condition.column for condition in (*NUMBERS, *CHOICES))])
    positions = spread(len(source.frames), most) if number is None else paged(len(source.frames), most, number)
    try:
        _prepare(out)
        shown, size = [], 0
        for place, position in enumerate(positions):
            image = source.image(position)
            script = frame_script(place, image, source.stars(position), source.objects(position))
            write_bytes(out / FRAMES_FOLDER / f"{place}.js", script)
            shown.append(_card(source.frames.iloc[position], image))
            size += len(script)
            progress(place + 1, len(positions))
        page = _page(source, shown, _words(positions, len(source.frames), most, number)).encode()
        write_bytes(out / PAGE, page)
    except OSError as error:
        raise GeneratorError(
            f"{error.filename or out}: writing failed ({error.strerror or error}); choose another --out"
        ) from error
    return Written(out / PAGE, len(positions), len(source.frames), size + len(page))


def spread(count: int, most: int) -> Sequence[int]:
    """Select at most `most` of `count` positions, evenly spread, including the first and the last if there are two."""
    return [int(position) for position in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


def paged(count: int, most: int, number: int) -> Sequence[int]:
    """Positions of the frames on a page, from 1, with `most` frames per page. Raises GeneratorError beyond the last page."""
    pages = -(-count // most)
    if not 1 <= number <= pages:
        raise GeneratorError(f"--page {number}: {count} frames fill {pages} pages of {most}; choose one of them")
    return range((number - 1) * most, min(number * most, count))


def _words(positions: Sequence[int], count: int, most: int, number: int | None) -> str:
    """Describe which of the frames are shown."""
    if len(positions) == count:
        return f"All {count} frames"
    if number is None:
        return f"{len(positions)} of {count} frames, evenly spread"
    return f"Frames {positions[0] + 1} to {positions[-1] + 1} of {count}, page {number} of {-(-count // most)}"


def _prepare(out: Path) -> None:
    """Create the folder and remove the pages of an earlier run; refuse a folder with other content."""
    out.mkdir(parents=True, exist_ok=True)
    strangers = sorted(path.name for path in out.iterdir() if path.name not in (PAGE, FRAMES_FOLDER))
    if strangers:
        raise GeneratorError(f"{out}: holds other files ({strangers[0]}, …); choose an empty folder with --out")
    (out / PAGE).unlink(missing_ok=True)
    if (out / FRAMES_FOLDER).is_symlink():
        raise GeneratorError(f"{out / FRAMES_FOLDER}: is a link to another folder; choose another --out")
    if (out / FRAMES_FOLDER).exists():
        shutil.rmtree(out / FRAMES_FOLDER)
    (out / FRAMES_FOLDER).mkdir()


def frame_script(number: int, image: NDArray[np.uint16], stars: pd.DataFrame, objects: pd.DataFrame) -> bytes:
    """Script that passes a frame to the page: ``skybench.receive({...})``."""
    reduced, block = _reduced(image)
    planes = np.concatenate([(reduced >> 8).astype(np.uint8).ravel(), (reduced & 255).astype(np.uint8).ravel()])
    content = {
        "number": number,
        "width": reduced.shape[1],
        "height": reduced.shape[0],
        "block": block,
        "black": int(np.percentile(reduced, 0.5)),
        "white": int(reduced.max()),
        "pixels": base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii"),
        "stars": _star_columns(stars, image.shape[1], image.shape[0]),
        "objects": _object_rows(objects),
    }
    # Only ASCII and no "<", so that nothing in it can be read as markup wherever it is inserted.
    text = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f"skybench.receive({text});\n".encode("ascii")


def _reduced(image: NDArray[np.uint16]) -> tuple[NDArray[np.uint16], int]:
    """Average an image over blocks if it is large; returns it with the side of the blocks."""
    block = max(1, int(np.ceil(np.sqrt(image.size / MOST_PIXELS))))
    if block == 1:
        return image, 1
    height, width = (side // block * block for side in image.shape)
    blocks = image[:height, :width].reshape(height // block, block, width // block, block)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint16), block


def _numbers(table: pd.DataFrame, column: str, decimals: int) -> list[float | None]:
    """Convert a column to numbers for JSON; None where a value is not finite."""
    values = pd.to_numeric(table[column], errors="coerce").to_numpy(np.float64)
    return [round(float(value), decimals) if np.isfinite(value) else None for value in values]


def _star_columns(stars: pd.DataFrame, width: int, height: int) -> dict[str, list[Any]]:
    """Columns of the brightest stars in the frame, including hidden ones."""
    hidden = stars["occluded"] & stars["u_px"].between(-0.5, width - 0.5) & stars["v_px"].between(-0.5, height - 0.5)
    inside = stars[(stars["fraction_in_frame"] > 0.5) | hidden].sort_values("v_mag", kind="stable").head(MOST_STARS)
    ids = zip(inside["star_id"], inside["hip"], inside["hr"], strict=True)
    return {
        "name": [star_name(int(star_id), int(hip), int(hr)) for star_id, hip, hr in ids],
        "planet": [bool(kind == "planet") for kind in inside["kind"]],
        "v": _numbers(inside, "v_mag", 2),
        "bv": _numbers(inside, "bv_mag", 2),
        "snr": _numbers(inside, "snr", 1),
        "electrons": _numbers(inside, "electrons_e", 1),
        "u": _numbers(inside, "centroid_u_px", 2),
        "y": _numbers(inside, "centroid_v_px", 2),
        "u0": _numbers(inside, "start_u_px", 1),
        "y0": _numbers(inside, "start_v_px", 1),
        "u1": _numbers(inside, "end_u_px", 1),
        "y1": _numbers(inside, "end_v_px", 1),
        "saturated": [bool(flag) for flag in inside["saturated"]],
        "occluded": [bool(flag) for flag in inside["occluded"]],
    }


def _object_rows(objects: pd.DataFrame) -> list[dict[str, Any]]:
    if objects.empty:
        return []
    places = {"u": "centroid_u_px", "y": "centroid_v_px", "u0": "start_u_px", "y0": "start_v_px", "u1": "end_u_px",
              "y1": "end_v_px"}  # fmt: skip
    columns = {name: _numbers(objects, column, 1) for name, column in places.items()}
    columns |= {
        "v": _numbers(objects, "v_mag", 2),
        "electrons": _numbers(objects, "electrons_e", 0),
        "snr": _numbers(objects, "snr", 1),
    }
    return [
        {"kind": str(kind), "occluded": bool(hidden)} | {name: values[row] for name, values in columns.items()}
        for row, (kind, hidden) in enumerate(zip(objects["kind"], objects["occluded"], strict=True))
    ]


def _card(row: pd.Series, image: NDArray[np.uint16]) -> dict[str, Any]:
    """What the page itself holds about a frame: its thumbnail and its conditions."""
    frame = pd.DataFrame([row])
    numbers = {
        condition.column: _numbers(frame, condition.column, max(condition.decimals, 4))[0]
        for condition in NUMBERS
        if condition.column in frame
    }
    choices = {condition.column: _choice(row.get(condition.column)) for condition in CHOICES}
    return {
        "id": str(row["frame_id"]),
        "utc": str(row["utc_mid"]),
        "picture": "data:image/webp;base64," + base64.b64encode(preview_webp(image, THUMBNAIL_PX)).decode("ascii"),
        "values": numbers | choices,
    }


def _choice(value: object) -> str:
    """A value by which frames are selected, as text; empty where there is none."""
    if value is None or value == "" or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return f"{value:g}" if isinstance(value, float) else str(value)


def _page(source: Source, shown: list[dict[str, Any]], words: str) -> str:
    content = {
        "frames": shown,
        "numbers": [_histogram(source.frames, condition) for condition in _varying(source.frames, NUMBERS)],
        "choices": [
            {"column": condition.column, "title": condition.title, "values": values}
            for condition in CHOICES
            if 1 < len(values := _values(source.frames, condition.column)) <= MOST_CHOICES
        ],
        "conditions": [
            {"column": c.column, "title": c.title, "unit": c.unit, "decimals": c.decimals} for c in (*NUMBERS, *CHOICES)
        ],
    }
    return render_page(
        "show.html",
        scenario=source.scenario,
        sha256=source.scenario_sha256,
        total=len(source.frames),
        shown=words,
        most_stars=MOST_STARS,
        content=content,
        style=Markup(read_sheet("show.css")),
        script=Markup(read_sheet("show.js")),
    )


def _column(frames: pd.DataFrame, condition: Condition) -> NDArray[np.float64]:
    """Finite values of a condition over all frames."""
    if condition.column not in frames:
        return np.zeros(0)
    values = pd.to_numeric(frames[condition.column], errors="coerce").to_numpy(np.float64)
    return values[np.isfinite(values)]


def _varying(frames: pd.DataFrame, conditions: tuple[Condition, ...]) -> list[Condition]:
    return [condition for condition in conditions if len(np.unique(_column(frames, condition))) > 1]


def _values(frames: pd.DataFrame, column: str) -> list[str]:
    """Distinct values of a column as texts, in ascending order."""
    if column not in frames:
        return []
    return [text for value in sorted(set(frames[column].dropna())) if (text := _choice(value))]


def _histogram(frames: pd.DataFrame, condition: Condition) -> dict[str, Any]:
    """Counts of a condition over all frames of the dataset."""
    values = _column(frames, condition)
    counts, edges = np.histogram(values, bins=min(BINS, max(6, len(np.unique(values)))))
    return {
        "column": condition.column,
        "title": condition.title,
        "unit": condition.unit,
        "decimals": condition.decimals,
        "counts": counts.tolist(),
        "low": float(edges[0]),
        "high": float(edges[-1]),
    }
