"""Stacks of video frames: mean, maximum, the maximum's frame, standard deviation, as meteor cameras store them.

The Global Meteor Network keeps 256 frames of 8 bits as four pictures, in FITS files named FF (Vida et al. 2021, MNRAS
506, 5046; four-frame temporal pixel: Gural 2011, Proc. IMC 2010). Their integer arithmetic is part of the format: the
highest value of a pixel is left out of mean and standard deviation, the mean is rounded down, and the standard deviation
is about the rounded mean. This raises the variance if the mean has a fraction, by up to the mean itself.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.scenario.processing.video_spec import FEWEST_FRAMES, MOST_FRAMES

Picture = NDArray[np.uint8]

PICTURES = ("MAXPIXEL", "MAXFRAME", "AVEPIXEL", "STDPIXEL")
"""Names and order of the extensions of a file."""


@dataclass(frozen=True)
class Stack:
    """Four pictures that summarise a stack of frames, (height, width) uint8 arrays each.

    Attributes
    ----------
    maximum : array
    maximum_frame : array
        Number of the frame with the maximum, from 0; if several have it, one of them at random.
    mean : array
        Mean without the maximum, rounded down.
    deviation : array
        Standard deviation without the maximum, about the rounded mean, rounded down; at least 1.
    frames : int
        Number of frames.
    """

    maximum: Picture
    maximum_frame: Picture
    mean: Picture
    deviation: Picture
    frames: int


def stack(frames: Iterable[Picture], random: np.random.Generator) -> Stack:
    """Stack 3 to 256 frames (height, width), holding only one at a time in memory.

    Raises
    ------
    ValueError
        There are fewer or more frames.
    """
    count = 0
    for count, frame in enumerate(frames, start=1):
        if count > MOST_FRAMES:
            raise ValueError(f"a stack has {FEWEST_FRAMES} to {MOST_FRAMES} frames, not more")
        if count == 1:
            total, squares = np.zeros(frame.shape, np.int64), np.zeros(frame.shape, np.int64)
            highest, which = np.zeros(frame.shape, np.uint8), np.zeros(frame.shape, np.uint8)
            equal = np.zeros(frame.shape, np.float32)
        wide = frame.astype(np.int64)
        total += wide
        squares += wide * wide
        above = frame > highest
        equal = np.where(above, 1, equal + (frame == highest)).astype(np.float32)
        # Each of n frames with the highest value is kept with a probability of 1 / n (reservoir sampling).
        kept = above | ((frame == highest) & (random.random(frame.shape, dtype=np.float32) * equal < 1))
        which[kept] = count - 1
        np.maximum(highest, frame, out=highest)
    if count < FEWEST_FRAMES:
        raise ValueError(f"a stack has {FEWEST_FRAMES} to {MOST_FRAMES} frames, not {count}")
    top = highest.astype(np.int64)
    left = total - top
    mean = left // (count - 1)
    variance = (squares - top * top - left * mean) // (count - 2)
    deviation = np.maximum(np.floor(np.sqrt(variance)), 1)
    return Stack(highest, which, mean.astype(np.uint8), deviation.astype(np.uint8), count)


def fits_bytes(pile: Stack, frames_per_s: float, camera: str) -> bytes:
    """The pictures as a FITS file in the form of the Global Meteor Network's FF files, the top row first."""
    from astropy.io import fits

    height, width = pile.mean.shape
    header = fits.Header()
    header["NROWS"], header["NCOLS"], header["NBITS"] = height, width, 8
    header["NFRAMES"], header["FIRST"], header["CAMNO"], header["FPS"] = pile.frames, 0, camera, frames_per_s
    pictures = (pile.maximum, pile.maximum_frame, pile.mean, pile.deviation)
    units = [fits.ImageHDU(picture, name=name) for name, picture in zip(PICTURES, pictures, strict=True)]
    stored = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(header=header), *units]).writeto(stored)
    return stored.getvalue()
