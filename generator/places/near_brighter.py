"""Hipparcos stars next to brighter ones, corrected with Tycho-2.

Hipparcos' detector saw a field of some 30 arcsec at once (ESA 1997, SP-1200, volume 3, chapter 5). The new reduction
therefore assigns most of the light of a brighter star to a neighbour within 15 arcsec, too (epsilon Equ C has V 5.2
there, and 7.0 in Tycho-2), and some neighbours a spurious proper motion. For these, ``data/tycho2/near_brighter.csv``
contains V, places and proper motions from Tycho-2 (Hog et al. 2000, A&A 355, L27), which was measured with a slit.
``tools/build_tycho2.py`` writes the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from generator.csv_table import CsvError, read_csv
from generator.errors import DataFileError

if TYPE_CHECKING:
    import pandas as pd

NEAR_BRIGHTER_PATH = Path(__file__).parents[1] / "data" / "tycho2" / "near_brighter.csv"
COLUMNS = ("hip", "ra_deg", "dec_deg", "pm_ra_mas_yr", "pm_dec_mas_yr", "v_mag")
MOST_ROWS = 10_000


def read_near_brighter(path: Path = NEAR_BRIGHTER_PATH) -> NDArray[np.float64]:
    """Read the file's rows, in the order of COLUMNS.

    Raises
    ------
    DataFileError
        The file cannot be read or is a different one.
    """
    try:
        return read_csv(path, str(path), COLUMNS, most_rows=MOST_ROWS).values
    except (OSError, CsvError) as error:
        raise DataFileError(f"{path}: cannot be read ({error}); reinstall skybench") from error


def with_own_light(hipparcos: pd.DataFrame) -> pd.DataFrame:
    """Return Hipparcos (columns of COLUMNS and others) with the light and the motion of those stars alone."""
    rows = read_near_brighter()
    number = hipparcos["hip"].to_numpy()
    order = np.argsort(number)
    place = order[np.searchsorted(number, rows[:, 0], sorter=order) % len(order)]
    known = number[place] == rows[:, 0]
    mended = hipparcos.copy()
    for column, name in enumerate(COLUMNS[1:], start=1):
        values = mended[name].to_numpy(float).copy()
        values[place[known]] = rows[known, column]
        mended[name] = values
    return mended
