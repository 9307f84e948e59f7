"""Grey or colour 8-bit frames through an H.264 codec: coded as a camera codes them, and decoded again.

Grey frames are the luma as they are, 0 to 255. Colour frames are red, green and blue after the transfer curve; luma and
differences of colour are those of ITU-R BT.709-6 (sections 3 and 4, narrow range: black 16, white 235), the differences means
over 2 x 2 pixels, and the file says so (ITU-T H.273, code points 1 and narrow range).
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
"""Both differences of colour of a grey picture."""
LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green, blue."""
BLACK, LUMA_RANGE, COLOUR_RANGE = 16, 219, 224
BLUE_DIFFERENCE, RED_DIFFERENCE = 1.8556, 1.5748
"""Ranges of blue and of red less luma."""
BT709 = 1
NARROW = 1
"""libav's numbers of the matrix, the primaries and the curve of BT.709, and of the narrow range."""
ROWS_AT_ONCE = 64
"""Rows converted in one step: what they need fits into the processor's cache."""


def encode(frames: Iterable[Picture], shape: tuple[int, int], frames_per_s: float, spec: H264Spec) -> bytes:
    """An MP4 file of frames (height, width) or (height, width, 3), height and width even as in `shape`.

    One thread and no frames that refer to later ones, as cameras code: the same frames give the same bytes with the same
    build of x264.

    Raises
    ------
    GeneratorError
        PyAV was built without x264.
    """
    # Loads FFmpeg, which other frames need not wait for.
    import av

    if ENCODER not in av.codecs_available:
        raise GeneratorError(
            f"sensor.video.codec: this PyAV has no {ENCODER}; install the wheel of PyPI, or set codec: none"
        )
    rate = Fraction(frames_per_s).limit_denominator(1000)
    options = {"preset": "veryfast", "threads": "1", "bf": "0", "refs": "1", "sc_threshold": "0"}
    options["g"] = str(spec.keyframe_every)
    if spec.bitrate_kbit_s is None:
        options["crf"] = str(spec.crf)
    else:
        # The buffer of a second is what a camera at a constant bit rate allows itself.
        bits = str(round(1000 * spec.bitrate_kbit_s))
        options |= {"b": bits, "maxrate": bits, "bufsize": bits}
    stored = io.BytesIO()
    with av.open(stored, "w", format="mp4") as container:
        stream: Any = container.add_stream(ENCODER, rate=rate, options=options)
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


def colour_planes(frame: Picture) -> Picture:
    """Luma over blue and red difference, (3 height / 2, width), of a frame (height, width, 3): the layout of yuv420p."""
    height, width = frame.shape[:2]
    planes = np.empty((3 * height // 2, width), np.uint8)
    differences = planes[height:].reshape(2, height // 2, width // 2)
    for start in range(0, height, ROWS_AT_ONCE):
        rows = slice(start, min(start + ROWS_AT_ONCE, height))
        light = frame[rows] / np.float64(255)
        luma = light @ LUMA
        planes[rows] = np.rint(BLACK + LUMA_RANGE * luma)
        halves = slice(rows.start // 2, rows.stop // 2)
        for plane, channel, span in ((0, 2, BLUE_DIFFERENCE), (1, 0, RED_DIFFERENCE)):
            difference = (light[..., channel] - luma).reshape(-1, 2, width // 2, 2).mean(axis=(1, 3)) / span
            differences[plane, halves] = np.rint(NEUTRAL + COLOUR_RANGE * difference)
    return planes


def grey(frame: Picture) -> Picture:
    """Luma of a frame from 0 to 255, (height, width)."""
    return frame if frame.ndim == 2 else np.rint(frame @ LUMA).astype(np.uint8)


def _whole_range(luma: Picture) -> Picture:
    """Luma of the narrow range as 0 to 255; what lies beyond black and white is cut."""
    return np.rint(np.clip((luma - float(BLACK)) * (255 / LUMA_RANGE), 0, 255)).astype(np.uint8)


def decode(video: bytes) -> Iterator[Picture]:
    """Luma of the frames of a video that :func:`encode` made, (height, width) each from 0 to 255, in order."""
    import av

    with av.open(io.BytesIO(video), "r", format="mp4") as container:
        for frame in container.decode(video=0):
            luma = np.asarray(frame.to_ndarray(format=PIXEL_FORMAT), dtype=np.uint8)[: frame.height]
            yield _whole_range(luma) if frame.color_range == NARROW else luma
