"""Encode grey or colour 8-bit frames with H.264 as a camera does, and decode them again.

Grey frames are the unchanged luma, 0 to 255. Colour frames are red, green and blue after the transfer curve; luma and
colour differences are those of ITU-R BT.709-6 (sections 3 and 4, narrow range: black 16, white 235), the differences are
means over 2 x 2 pixels, and the file states this (ITU-T H.273, code points 1 and narrow range).
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.errors import GeneratorError
from generator.scenario.processing.video_spec import H264Spec

Picture = NDArray[np.uint8]

ENCODER = "libx264"
PIXEL_FORMAT = "yuv420p"
NEUTRAL = 128
"""Value of both colour differences in a grey picture."""
LUMA, LUMA_UNIT = (2126, 7152, 722), 10000
"""Weights of red, green, blue, and their sum. They are integers because the rounding of a sum of fractions depends on the
order in which a library adds."""
BLACK, LUMA_RANGE, COLOUR_RANGE = 16, 219, 224
BLUE_DIFFERENCE, RED_DIFFERENCE = 18556, 15748
"""Ranges of blue minus luma and of red minus luma, in units of LUMA_UNIT."""
BT709 = 1
NARROW = 1
"""libav's numbers of the matrix, the primaries and the curve of BT.709, and of the narrow range."""
ROWS_AT_ONCE = 64
"""Rows converted in one step, so that the data fit into the processor's cache."""
EVERY_PROCESSOR = "cpu-independent=1"
"""Without this option, x264 distributes the macroblock tree's costs with processor-specific instructions, whose results
differ."""


def encode(frames: Iterable[Picture], shape: tuple[int, int], frames_per_s: float, spec: H264Spec) -> bytes:
    """Encode frames (height, width) or (height, width, 3) as an MP4 file; height and width are even as in `shape`.

    It uses one thread and no frames that refer to later ones, as cameras do. The same frames give the same bytes with the
    same build of x264, on any processor.

    Raises
    ------
    GeneratorError
        PyAV was built without x264.
    """
    # This import loads FFmpeg, which other frames do not need.
    import av

    if ENCODER not in av.codecs_available:
        raise GeneratorError(
            f"sensor.video.codec: this PyAV has no {ENCODER}; install the wheel of PyPI, or set codec: none"
        )
    rate = Fraction(frames_per_s).limit_denominator(1000)
    stored = io.BytesIO()
    with av.open(stored, "w", format="mp4") as container:
        stream: Any = container.add_stream(ENCODER, rate=rate, options=encoder_options(spec))
        stream.pix_fmt = PIXEL_FORMAT
        height, width = shape
        stream.height, stream.width = height, width
        for number, frame in enumerate(frames):
            if frame.ndim == 3:
                planes = colour_planes(frame)
                if number == 0:
                    context = stream.codec_context
                    context.color_range, context.colorspace = NARROW, BT709
                    context.color_primaries = context.color_trc = BT709
            else:
                planes = np.full((3 * height // 2, width), NEUTRAL, np.uint8)
                planes[:height] = frame
            container.mux(stream.encode(av.VideoFrame.from_ndarray(planes, format=PIXEL_FORMAT)))
        container.mux(stream.encode(None))
    return stored.getvalue()


def encoder_options(spec: H264Spec) -> dict[str, str]:
    """Options of libav's encoder."""
    options = {"preset": "veryfast", "threads": "1", "bf": "0", "refs": "1", "sc_threshold": "0"}
    options |= {"g": str(spec.keyframe_every), "x264-params": EVERY_PROCESSOR}
    if spec.bitrate_kbit_s is None:
        return options | {"crf": str(spec.crf)}
    # A buffer of one second is usual for a camera with a constant bit rate.
    bits = str(round(1000 * spec.bitrate_kbit_s))
    return options | {"b": bits, "maxrate": bits, "bufsize": bits}


def colour_planes(frame: Picture) -> Picture:
    """Luma over blue and red difference, (3 height / 2, width), of a frame (height, width, 3): the layout of yuv420p."""
    height, width = frame.shape[:2]
    planes = np.empty((3 * height // 2, width), np.uint8)
    differences = planes[height:].reshape(2, height // 2, width // 2)
    for start in range(0, height, ROWS_AT_ONCE):
        rows = slice(start, min(start + ROWS_AT_ONCE, height))
        luma = _luma(frame[rows])
        planes[rows] = _quotient(LUMA_RANGE * luma, 255 * LUMA_UNIT) + BLACK
        halves = slice(rows.start // 2, rows.stop // 2)
        for plane, channel, span in ((0, 2, BLUE_DIFFERENCE), (1, 0, RED_DIFFERENCE)):
            difference = np.int32(LUMA_UNIT) * frame[rows, :, channel] - luma
            four = difference.reshape(-1, 2, width // 2, 2).sum(axis=(1, 3), dtype=np.int64)
            differences[plane, halves] = _quotient(COLOUR_RANGE * four, 4 * 255 * span) + NEUTRAL
    return planes


def grey(frame: Picture) -> Picture:
    """Luma of a frame from 0 to 255, (height, width)."""
    return frame if frame.ndim == 2 else _quotient(_luma(frame), LUMA_UNIT).astype(np.uint8)


def _luma(frame: Picture) -> NDArray[np.int32]:
    """Luma of a frame (height, width, 3) from 0 to 255 LUMA_UNIT."""
    red, green, blue = (np.int32(weight) * frame[..., channel] for channel, weight in enumerate(LUMA))
    luma: NDArray[np.int32] = red + green + blue
    return luma


def _quotient(values: NDArray[Any], divisor: int) -> NDArray[Any]:
    """Divide integers by an integer, rounding halves up."""
    quotient: NDArray[Any] = (2 * values + divisor) // (2 * divisor)
    return quotient


def _whole_range(luma: Picture) -> Picture:
    """Expand luma from the narrow range to 0 to 255; values beyond black and white are clipped."""
    return np.rint(np.clip((luma - float(BLACK)) * (255 / LUMA_RANGE), 0, 255)).astype(np.uint8)


def decode(video: bytes) -> Iterator[Picture]:
    """Decode a video from :func:`encode` and yield the luma of its frames in order, (height, width) each, from 0 to 255."""
    import av

    with av.open(io.BytesIO(video), "r", format="mp4") as container:
        for frame in container.decode(video=0):
            luma = np.asarray(frame.to_ndarray(format=PIXEL_FORMAT), dtype=np.uint8)[: frame.height]
            yield _whole_range(luma) if frame.color_range == NARROW else luma
