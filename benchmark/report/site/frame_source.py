"""Pictures of frames and their true stars, where these are available."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from benchmark.errors import ResultsError
from benchmark.frames.identity import UNKNOWN
from benchmark.frames.preview import preview_webp
from benchmark.frames.sharded import dataset_folder
from benchmark.frames.task_frames import UNPACKED, split_folder
from benchmark.frames.task_shards import star_folders
from benchmark.judge.star_id import TRACE_SNR
from benchmark.report.site.tree import StoredResult
from benchmark.run.identities import identities_in
from benchmark.run.results import RUN_AGAIN
from generator.errors import GeneratorError
from generator.identity.pixels import pixels_sha256
from generator.reading.table import check_claims

MOST_STARS = 200
_FRAME_ID = re.compile(r"frame-[0-9]{5,8}")
_STAR_COLUMNS = ("frame_id", "u_px", "v_px", "electrons_e", "snr")


def is_frame_id(frame_id: str) -> bool:
    """Whether a name is the id of a frame, so that it can be a file's name; results of strangers may contain any."""
    return _FRAME_ID.fullmatch(frame_id) is not None


@dataclass(frozen=True)
class FrameSource:
    """Where frames are looked up.

    Attributes
    ----------
    data : Path or None
        Folder of the frames of tasks and of sharded datasets. Frames of a rendered folder are looked up in that folder.
    """

    data: Path | None = None

    def picture(self, result: StoredResult, frame_id: str, width_px: int) -> bytes | None:
        """Stretched WebP picture of a frame, at most `width_px` wide; None where the frame of the result is not available.

        Raises
        ------
        ResultsError
            The image is damaged.
        """
        place = self._place(result)
        if place is None or not is_frame_id(frame_id):
            return None
        image = place.images / f"{frame_id}.png"
        if not image.is_file():
            return None
        try:
            with Image.open(image, formats=["PNG"]) as opened:
                pixels = np.asarray(opened).astype(np.uint16)
        except (UnidentifiedImageError, OSError, ValueError) as error:
            raise ResultsError(f"{image}: not a readable image ({error}); delete it and {RUN_AGAIN}") from error
        return preview_webp(pixels, width_px) if _is_the_one(pixels, result, frame_id) else None

    def true_stars(self, result: StoredResult, frame_ids: Sequence[str]) -> dict[str, list[tuple[float, float]]]:
        """Positions (px) of the brightest stars that leave a trace, by frame; empty where the truth is not available.

        Raises
        ------
        ResultsError
            A table of stars is damaged.
        """
        place = self._place(result)
        known_ids = sorted({frame_id for frame_id in frame_ids if is_frame_id(frame_id)})
        if place is None or not known_ids:
            return {}
        tables, seen = [], set[str]()
        for path in place.star_tables():
            wanted = [("frame_id", "in", known_ids), ("snr", ">=", TRACE_SNR)]
            try:
                check_claims(path)
                table = pq.read_table(path, columns=list(_STAR_COLUMNS), filters=wanted).to_pandas()
            except (GeneratorError, pa.ArrowException, OSError) as error:
                raise ResultsError(
                    f"{path}: damaged ({str(error).splitlines()[0]}); delete it and {RUN_AGAIN}"
                ) from error
            tables.append(table[~table["frame_id"].isin(seen)])
            seen |= set(table["frame_id"])
        if not tables:
            return {}
        places: dict[str, list[tuple[float, float]]] = {}
        for name, stars in pd.concat(tables).groupby("frame_id"):
            known = stars["electrons_e"].notna().all()  # for photographs they may be unknown
            brightest = stars.nlargest(MOST_STARS, "electrons_e" if known else "snr")
            places[str(name)] = list(zip(brightest["u_px"].tolist(), brightest["v_px"].tolist(), strict=True))
        return places

    def _place(self, result: StoredResult) -> _Place | None:
        """Find the folder of a result's frames, if there is one."""
        frames = result.provenance.frames
        rendered = Path(frames.target)
        if frames.grading is None and frames.definition_sha256 is None:
            return _Place(rendered, (rendered,)) if _is_of(rendered, frames.scenario_sha256) else None
        if self.data is None:
            return None
        if frames.grading is not None:
            folder = split_folder(frames.label, frames.split, frames.scenario_sha256, self.data)
        else:
            folder = dataset_folder(str(frames.definition_sha256), self.data)
        return _Place(folder / UNPACKED, star_folders(folder, frames.split)) if folder.is_dir() else None


@dataclass(frozen=True)
class _Place:
    """Folders of images and of tables of stars; for rendered frames one folder, whose other tables contain no stars."""

    images: Path
    stars: tuple[Path, ...]

    def star_tables(self) -> list[Path]:
        """Files with the truth of stars, without the unfinished ones that a killed run leaves (`.shard-…`)."""
        name = "stars.parquet" if self.images in self.stars else "[!.]*.parquet"
        return [path for folder in self.stars for path in sorted(folder.glob(name))]


def _is_the_one(pixels: NDArray[np.uint16], result: StoredResult, frame_id: str) -> bool:
    """Whether an image is the one that a result is of, by its hash; a result that states no hash is trusted."""
    stated = identities_in(result.frames).get(frame_id, UNKNOWN).image_sha256
    return stated is None or stated == pixels_sha256(pixels)


def _is_of(folder: Path, scenario_sha256: str) -> bool:
    """Whether a folder contains frames of a scenario, which gives the same frames wherever it is rendered."""
    record = next(iter(sorted(folder.glob("frame-*.json"))), None) if folder.is_dir() else None
    try:
        return record is not None and json.loads(record.read_bytes())["scenario"]["sha256"] == scenario_sha256
    except (OSError, ValueError, KeyError, TypeError):
        return False
