"""Reading a user's stack of point spread functions: a FITS cube or an EXR with one channel per function."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.scenario.strict import InputFile

FITS_START = b"SIMPLE  ="
MOST_FUNCTIONS = 64
LARGEST_SIDE_PX = 120
"""Twice the largest support_px of the camera's psf."""


class StackError(ValueError):
    """The stack cannot be used."""


@functools.lru_cache(maxsize=8)
def read_stack(file: InputFile, oversampling: int) -> NDArray[np.float64]:
    """Read a stack, each function normalised to sum 1.

    Parameters
    ----------
    file : InputFile
    oversampling : int
        Samples per pixel.

    Returns
    -------
    (n, size, size) array

    Raises
    ------
    StackError
        The file is not a stack of square, non-negative images with an odd side of a usable size.
    """
    name = Path(file.location)
    read = _read_fits if name.suffix.lower() in (".fits", ".fit", ".fts") else _read_exr
    try:
        stack = read(name, oversampling)
    except StackError:
        raise
    except (OSError, RuntimeError, TypeError, KeyError, ValueError, OverflowError) as error:
        reason = " ".join(str(error).split())[:200]
        raise StackError(f"found '{file.path}', which cannot be read as FITS or EXR ({reason})") from error
    if not np.isfinite(stack).all() or stack.min() < 0 or (stack.sum(axis=(1, 2)) <= 0).any():
        raise StackError("found values that are negative or not finite, or a function without light")
    return stack / stack.sum(axis=(1, 2), keepdims=True)


def _check_shape(shape: tuple[int, ...], oversampling: int) -> None:
    """Check the shape that a header states, before anything is decoded."""
    if len(shape) != 3 or shape[1] != shape[2] or shape[1] % 2 == 0 or not 1 <= shape[0] <= MOST_FUNCTIONS:
        raise StackError(
            f"found shape {shape}, expected (n, side, side) with an odd side and n from 1 to {MOST_FUNCTIONS}"
        )
    if not 3 <= shape[1] <= LARGEST_SIDE_PX * oversampling:
        raise StackError(f"found a side of {shape[1]} samples, expected 3 to {LARGEST_SIDE_PX * oversampling}")


def _read_fits(name: Path, oversampling: int) -> NDArray[np.float64]:
    from astropy.io import fits

    with name.open("rb") as file:
        if file.read(len(FITS_START)) != FITS_START:
            raise StackError("found a file that does not begin as FITS does; compressed files are not read")
        file.seek(0)
        header = fits.Header.fromfile(file)
    try:
        stated = tuple(int(header[f"NAXIS{axis}"]) for axis in range(int(header["NAXIS"]), 0, -1))
    except fits.VerifyError as error:
        raise ValueError(error) from error
    shape = (1, *stated) if len(stated) == 2 else stated
    _check_shape(shape, oversampling)
    with fits.open(name, memmap=False, disable_image_compression=True) as content:
        return np.array(content[0].data, dtype=np.float64).reshape(shape)


def _read_exr(name: Path, oversampling: int) -> NDArray[np.float64]:
    import OpenEXR

    with OpenEXR.File(str(name), separate_channels=True, header_only=True) as content:
        # The reader decodes all parts, whatever the first one says.
        if len(content.parts) != 1:
            raise StackError(f"found {len(content.parts)} parts, expected one with a channel per function")
        header = content.header()
        (left, top), (right, bottom) = header["dataWindow"]
        _check_shape((len(header["channels"]), int(bottom - top + 1), int(right - left + 1)), oversampling)
    with OpenEXR.File(str(name), separate_channels=True) as content:
        channels = content.channels()
        return np.array([channels[key].pixels for key in sorted(channels)], dtype=np.float64)
