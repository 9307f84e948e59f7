"""Pictures of frames and their true stars, from where they are at hand."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image, UnidentifiedImageError

from benchmark.errors import ResultsError
from benchmark.frames.preview import preview_webp
from benchmark.judge.star_id import TRACE_SNR
from benchmark.report.site.tree import StoredResult
from benchmark.run.results import PREVIEW_FOLDER

MOST_STARS = 200
# A task that varies what solvers are told has several frame ids to a picture, with the level at their end.
_RENDERED_ID = re.compile(r"frame-[0-9]{5,8}")


@dataclass(frozen=True)
class FrameSource:
    """Where frames may be found.

    Attributes
    ----------
    data : Path or None
        Folder of the tasks' rendered frames, ``data/<task>@<revision>/<split>-<scenario>/``. Previews beside the
        results, ``<task>@<revision>/<split>/previews/<frame>.webp``, are taken first.
    """

    data: Path | None = None

    def picture(self, result: StoredResult, frame_id: str) -> bytes | None:
        """WebP picture of a frame, stretched; None where the frame is not at hand.

        Raises
        ------
        ResultsError
            It is damaged.
        """
        rendered = _RENDERED_ID.match(frame_id)
        if rendered is None:
            return None
        names = dict.fromkeys((Path(frame_id).name, rendered.group()))
        for name in names:
            path = result.folder.parents[1] / PREVIEW_FOLDER / f"{name}.webp"
            if path.is_file():
                return path.read_bytes()
        folder = self._folder(result)
        image = folder / "unpacked" / f"{rendered.group()}.png" if folder else None
        if image is None or not image.is_file():
            return None
        try:
            with Image.open(image, formats=["PNG"]) as opened:
                return preview_webp(np.asarray(opened).astype(np.uint16))
        except (UnidentifiedImageError, OSError, ValueError) as error:
            raise ResultsError(f"{image}: not a readable image ({error}); delete it and run the task again") from error

    def true_stars(self, result: StoredResult, frame_id: str) -> list[tuple[float, float]]:
        """Positions (px) of a frame's brightest stars that leave a trace; none where the truth is not at hand.

        Raises
        ------
        ResultsError
            The table of stars is damaged.
        """
        rendered, folder = _RENDERED_ID.match(frame_id), self._folder(result)
        if rendered is None or folder is None:
            return []
        for path in sorted((folder / "stars" / result.split).glob("*.parquet")):
            wanted = [("frame_id", "=", rendered.group()), ("snr", ">=", TRACE_SNR)]
            try:
                stars = pq.read_table(path, columns=["u_px", "v_px", "electrons_e"], filters=wanted).to_pandas()
            except (pa.ArrowException, OSError) as error:
                raise ResultsError(f"{path}: damaged ({error}); delete it and run the task again") from error
            if len(stars):
                brightest = stars.nlargest(MOST_STARS, "electrons_e")
                return list(zip(brightest["u_px"].tolist(), brightest["v_px"].tolist(), strict=True))
        return []

    def _folder(self, result: StoredResult) -> Path | None:
        if self.data is None:
            return None
        folder = self.data / result.task.key / f"{result.split}-{result.provenance.scenario_sha256[:12]}"
        return folder if folder.is_dir() else None
