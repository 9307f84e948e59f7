"""Files from a third party that `skybench twin` is given, looked at before they are read: photographs, mask, passing trails.

Masks are opened as the two formats that their option names: others, such as EPS, run programs outside Python.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from PIL import Image

from benchmark.errors import PhotographError
from benchmark.twin.scene import read_passing
from benchmark.twin.stacked_video import PICTURES, start_of
from benchmark.yaml_file import read_yaml
from celnav.command.checks.input_files import LARGEST_IMAGE_BYTES, check_file
from celnav.errors import ImageError
from celnav.reading.fits_file import unpacked_bytes

LARGEST_PASSING_BYTES = 1_000_000
MASK_FORMATS = ("PNG", "BMP")


def read_given_passing(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Read what flew through photographs, as `read_passing` does.

    Raises
    ------
    PhotographError
        The file is no strict YAML of at most LARGEST_PASSING_BYTES, or has other content.
    """
    expected = "expected trails of a scenario's foreground by names of photographs"
    try:
        read_yaml(path, LARGEST_PASSING_BYTES, PhotographError)
    except PhotographError as error:
        raise PhotographError(f"{error}; {expected}") from error
    try:
        return read_passing(path)
    except ValueError as error:  # of a word like a date that is none
        raise PhotographError(f"{path}: {expected} ({error})") from error


def check_photograph(path: Path) -> None:
    """Refuse a file that is no regular one, and a stack of video whose pictures have other than two axes.

    Raises
    ------
    PhotographError
        All other errors are those that the reader of photographs finds.
    """
    _check_regular(path, f"photograph {path}")
    if start_of(path.name) is None:
        return
    for part, axes in _axes(path).items():
        if axes != 2:
            raise PhotographError(f"{path}: its picture {part} has {axes} axes (NAXIS); one of a stack of video has 2")


def check_mask(path: Path) -> None:
    """Refuse a mask that is no PNG or BMP. Raises PhotographError."""
    _check_regular(path, f"mask {path}")
    try:
        with Image.open(path, formats=MASK_FORMATS):
            return
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise PhotographError(
            f"{path}: cannot be read as a picture ({error}); a mask is a PNG or a BMP of the photograph's size"
        ) from error


def _check_regular(path: Path, what: str) -> None:
    try:
        check_file(path, what, ImageError, LARGEST_IMAGE_BYTES)
    except ImageError as error:
        raise PhotographError(str(error)) from error


def _axes(path: Path) -> dict[str, object]:
    """Numbers of axes that the headers of a stack's pictures state; empty for a file that is no stack."""
    from astropy.io import fits

    try:
        with fits.open(io.BytesIO(unpacked_bytes(path)), memmap=False, disable_image_compression=True) as units:
            return {part: units[part].header.get("NAXIS") for part in PICTURES}
    except Exception:  # astropy raises errors of many types for damaged files, which the reader of stacks names
        return {}
