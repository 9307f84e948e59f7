"""A night of a station of the Global Meteor Network, as its program RMS stores it: FF files, .config, platepars.

An FF file contains 256 frames of video as four pictures; the mean (AVEPIXEL) is the photograph. Its name gives the time of
the first frame, UTC. Source: D. Vida et al., MNRAS 506, 5046-5074, 2021; github.com/CroatianMeteorNetwork/RMS,
RMS/Formats/FFfits.py.
"""

from __future__ import annotations

import configparser
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import celnav
from benchmark.errors import PhotographError
from benchmark.importing.drawn_centroids import checked_centroids, draw_centroids
from benchmark.importing.told import ToldCamera
from benchmark.place import Place
from generator.errors import GeneratorError
from generator.reading.json_text import strict_json

PLATEPARS = "platepars_all_recalibrated.json"
CONFIG = ".config"
LARGEST_CONFIG_BYTES = 1_000_000
LARGEST_PLATEPARS_BYTES = 200_000_000
_ENDINGS = (".fits", ".fits.gz", ".fits.bz2")
MOST_CALIBRATED = 12
"""Number of frames whose centroids calibrate a lens; more frames, evenly spread over a night, add little."""


@dataclass(frozen=True, eq=False)
class RmsNight:
    """A folder written by RMS.

    Attributes
    ----------
    files : list of Path
        FF files in the order of their names, which is that of time.
    place : Place
    station : str
    """

    files: list[Path]
    place: Place
    station: str


def read_night(folder: Path, place: Place | None = None, centroids_in: Path | None = None) -> RmsNight:
    """Read a folder of RMS: its files, and the place of the station from .config or from the platepars.

    With a folder `centroids_in`, the files are pictures of the measured centroids, which are drawn there
    (`benchmark.importing.drawn_centroids`), in place of the FF files.

    Raises
    ------
    PhotographError
        There is no FF file or no centroid, or the place is unknown; the message says what to do.
    """
    if not folder.is_dir():
        raise PhotographError(f"{folder}: no such folder")
    if centroids_in is not None:
        files = draw_centroids(folder / PLATEPARS, centroids_in)
    else:
        named = (path for path in folder.iterdir() if path.name.startswith("FF") and path.name.endswith(_ENDINGS))
        files = sorted(path for path in named if path.is_file())  # a device or a pipe has no end
    if not files:
        raise PhotographError(f"{folder}: no FF file (FF_STATION_DATE_TIME_MS_FRAME.fits, also .gz or .bz2) in it")
    found = place or _place_of_config(folder / CONFIG) or _place_of_platepars(folder / PLATEPARS)
    if found is None:
        raise PhotographError(
            f"{folder}: neither {CONFIG} nor {PLATEPARS} in it, so the place is not known; give --site LAT LON HEIGHT"
        )
    parts = files[0].name.split("_")
    return RmsNight(files, found, parts[1] if len(parts) > 2 else "station")


def calibrate_night(folder: Path, place: Place) -> ToldCamera:
    """Calibrate the camera on the centroids that RMS measured (without the names or poses that it assigned to them).

    Raises
    ------
    PhotographError
        There are no centroids, or the calibration fails.
    """
    path = folder / PLATEPARS
    if not path.is_file():
        raise PhotographError(
            f"{path}: missing, so the camera is not known; give --camera, made by `celnav calibrate` on some of the FF files"
        )
    try:
        frames = checked_centroids(path)
        chosen = frames[:: max(1, math.ceil(len(frames) / MOST_CALIBRATED))]
        found = celnav.calibrate(chosen, place.latitude_deg, place.longitude_deg, height_m=place.height_m)
    except celnav.CelnavError as error:
        words = str(error).removeprefix(f"{path}").removeprefix(":").strip()
        raise PhotographError(f"{path}: {words}; give --camera") from error
    return ToldCamera.calibrated(found)


def _place_of_config(path: Path) -> Place | None:
    """Read the place of a station from its .config; None where there is none."""
    if not path.is_file():
        return None
    parser = configparser.ConfigParser(inline_comment_prefixes=(";",), interpolation=None, strict=False)
    try:
        if path.stat().st_size > LARGEST_CONFIG_BYTES:
            raise PhotographError(f"larger than {LARGEST_CONFIG_BYTES} bytes")
        parser.read_string(path.read_text(encoding="utf-8"))
        return Place(*(float(parser["System"][key]) for key in ("latitude", "longitude", "elevation")))
    except PhotographError as error:
        raise PhotographError(f"{path}: {error}; mend it or give --site") from error
    except (OSError, UnicodeDecodeError, configparser.Error, KeyError, ValueError) as error:
        words = " ".join(str(error).split())
        raise PhotographError(
            f"{path}: [System] must have the numbers latitude, longitude and elevation ({words}); mend it or give --site"
        ) from error


def _place_of_platepars(path: Path) -> Place | None:
    """Read the place of a station from its platepars; None where there are none."""
    if not path.is_file():
        return None
    try:
        if path.stat().st_size > LARGEST_PLATEPARS_BYTES:
            raise PhotographError(f"{path}: larger than {LARGEST_PLATEPARS_BYTES // 10**6} MB")
        content: Any = strict_json(path.read_bytes(), str(path), LARGEST_PLATEPARS_BYTES)
    except (OSError, GeneratorError, json.JSONDecodeError) as error:
        words = str(error).removeprefix(f"{path}: ")
        raise PhotographError(f"{path}: {words}; mend it or give --site") from error
    try:
        first = content[min(content)]
        return Place(*(float(first[key]) for key in ("lat", "lon", "elev")))
    except PhotographError as error:
        raise PhotographError(f"{path}: {error}; mend it or give --site") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise PhotographError(
            f"{path}: its first platepar must have the numbers lat, lon and elev; mend it or give --site"
        ) from error
