"""What `read_rms_centroids` needs of a file of RMS' platepars: lists of stars with numbers, and names that can be written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from celnav.errors import CalibrationError

_LONGEST_SHOWN = 80


def check_rms_file(path: str | Path) -> None:
    """Check the frames of a ``platepars_all_recalibrated.json``.

    Raises
    ------
    CalibrationError
        The list of a frame's stars is no list or has a number beyond the range of floats, or a frame's name has characters
        that no file name has. All other errors are those that `read_rms_centroids` finds.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return
    if not isinstance(content, dict):
        return
    for name, platepar in sorted(content.items()):
        if not isinstance(platepar, dict) or not platepar.get("auto_recalibrated"):
            continue
        what = f"{path}: frame {name[:_LONGEST_SHOWN]!a}"
        if not name.isprintable():
            raise CalibrationError(f"{what}: its name must be that of a file, without control characters: mend it")
        rows = platepar.get("star_list")
        if rows and not isinstance(rows, list):
            raise CalibrationError(f"{what}: star_list must be rows of Julian date, row, column, intensity, …")
        try:
            np.array(rows or [], dtype=np.float64)
        except OverflowError:
            raise CalibrationError(f"{what}: star_list has a number beyond the range of floats: mend it") from None
        except (TypeError, ValueError):
            continue
