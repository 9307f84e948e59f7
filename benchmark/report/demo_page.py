"""The page of `skybench demo`: what was rendered, how many positions each solver found, and how accurate they were."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from benchmark.frames.dataset import Frame, load_image
from benchmark.frames.preview import preview_webp
from benchmark.report.formatting import number, percent
from benchmark.report.site.boards import Board, Entry
from benchmark.report.templates import read_sheet, render_page
from benchmark.stats.metrics import FIX
from generator.files import write_bytes
from generator.scenario.file import Scenario

PAGE = "index.html"
PICTURE_PX = 540
MOST_PICTURES = 3


@dataclass(frozen=True)
class SolverRow:
    """Summary of one solver's answers.

    Attributes
    ----------
    name, title, family : str
    found, wrong, refused, frames : int
        Fixes within the limit, fixes beyond it, frames without a fix (errors included), and all frames.
    median_km : float
        Median distance of the found positions from the truth; NaN where there are none.
    median_ms : float
        Median time per frame, including refused ones.
    by_bortle : tuple of (int, int, int)
        Bortle class, frames found and frames under it, darkest sky first.
    """

    name: str
    title: str
    family: str
    found: int
    wrong: int
    refused: int
    frames: int
    median_km: float
    median_ms: float
    by_bortle: tuple[tuple[int, int, int], ...]

    @property
    def distance(self) -> str:
        """Median distance in m or km."""
        return number(1000 * self.median_km, "m") if self.median_km < 1 else number(self.median_km, "km")


@dataclass(frozen=True)
class Picture:
    """A frame on the page: its picture as a data URI, its description, and how many solvers found its position."""

    uri: str
    caption: str
    found: int


@dataclass(frozen=True)
class Demo:
    """Content of the page; for solvers that cannot run here, `left_out` gives the reason and the remedy."""

    scenario: Scenario
    frames_folder: Path
    limit_km: float
    n_sites: int
    camera: str
    rows: tuple[SolverRow, ...]
    pictures: tuple[Picture, ...]
    example: Frame
    left_out: tuple[str, ...]

    @property
    def solve_command(self) -> str:
        """Command that solves one of the frames."""
        image, record = self.example.image_path, self.example.image_path.with_suffix(".json")
        options = ["--camera", record, "--attitude", record, "--utc", self.example.observation.utc]
        return shlex.join(["celnav", "solve", str(image), *map(str, options)])


def make_demo(
    scenario: Scenario, frames_folder: Path, frames: Sequence[Frame], board: Board, left_out: Sequence[str]
) -> Demo:
    """Gather the content of the page from a scenario's frames and from the solvers that were run on them."""
    rows = sorted(
        (_row(entry, board) for entry in board.entries), key=lambda row: (-row.found, row.median_km, row.name)
    )
    shown = shown_frames(frames)
    camera = scenario.frame(0).camera
    field = f", {frames[0].conditions.fov_deg:.0f}° wide" if frames[0].conditions.fov_deg else ""
    return Demo(
        scenario,
        frames_folder,
        board.task.limit_km,
        board.n_sites,
        f"{camera.width} x {camera.height} pixels{field}",
        tuple(rows),
        tuple(_picture(frame, board) for frame in shown),
        shown[len(shown) // 2],
        tuple(left_out),
    )


def write_demo(demo: Demo, folder: Path, details: Path) -> Path:
    """Write the page to a folder and return its path; `details` is the page with all numbers."""
    path = folder / PAGE
    page = render_page(
        "demo.html",
        demo=demo,
        style=Markup(read_sheet("page.css")),
        details=details.relative_to(folder).as_posix(),
        percent=percent,
        number=number,
    )
    write_bytes(path, page.encode())
    return path


def shown_frames(frames: Sequence[Frame]) -> list[Frame]:
    """Select at most three frames: from the first frame's site, the darkest to the brightest sky, else spread over all."""
    first = frames[0].conditions
    here = [frame for frame in frames if frame.conditions.latitude_deg == first.latitude_deg]
    skies = {frame.conditions.bortle: frame for frame in here if frame.conditions.bortle is not None}
    if len(skies) >= MOST_PICTURES:
        frames = [skies[bortle] for bortle in sorted(skies)]
    places = np.unique(np.linspace(0, len(frames) - 1, MOST_PICTURES).round().astype(int))
    return [frames[place] for place in places]


def _row(entry: Entry, board: Board) -> SolverRow:
    table = entry.stored.frames
    fixed = (table["status"] == FIX).to_numpy()
    errors_km = table["error_km"].to_numpy(float)
    found = fixed & (errors_km < board.task.limit_km)
    bortle = table["bortle"]
    classes = sorted({int(value) for value in bortle.dropna()})
    return SolverRow(
        name=entry.label,
        title=entry.stored.title,
        family=entry.stored.family,
        found=int(found.sum()),
        wrong=int((fixed & ~found).sum()),
        refused=int((~fixed).sum()),
        frames=len(table),
        median_km=float(np.median(errors_km[found])) if found.any() else float("nan"),
        median_ms=float(table["time_ms"].median()),
        by_bortle=tuple((each, int(found[bortle == each].sum()), int((bortle == each).sum())) for each in classes),
    )


def _picture(frame: Frame, board: Board) -> Picture:
    found = 0
    for entry in board.entries:
        table = entry.stored.frames
        (row,) = table[table["frame_id"] == frame.frame_id].to_dict("records")
        found += row["status"] == FIX and row["error_km"] < board.task.limit_km
    data = base64.b64encode(preview_webp(load_image(frame), PICTURE_PX)).decode("ascii")
    where = frame.conditions
    latitude = f"{abs(where.latitude_deg):.2f}° {'N' if where.latitude_deg >= 0 else 'S'}"
    longitude = f"{abs(where.longitude_deg):.2f}° {'E' if where.longitude_deg >= 0 else 'W'}"
    sky = "" if where.bortle is None else f"Bortle class {where.bortle}, "
    caption = f"{sky}{latitude}, {longitude}, {frame.observation.utc[:16].replace('T', ' ')} UTC"
    return Picture(f"data:image/webp;base64,{data}", caption, found)
