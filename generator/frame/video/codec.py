"""Grey 8-bit frames through an H.264 codec: coded as a camera codes them, and decoded again."""

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


def encode(frames: Iterable[Picture], shape: tuple[int, int], frames_per_s: float, spec: H264Spec) -> bytes:
    """An MP4 file of grey frames of a shape (height, width), both even.

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
        for frame in frames:
            planes = np.full((3 * height // 2, width), NEUTRAL, np.uint8)
            planes[:height] = frame
            container.mux(stream.encode(av.VideoFrame.from_ndarray(planes, format=PIXEL_FORMAT)))
        container.mux(stream.encode(None))
    return stored.getvalue()


def decode(video: bytes) -> Iterator[Picture]:
    """Luma of the frames of a video that :func:`encode` made, (height, width) each, in order."""
    import av

    with av.open(io.BytesIO(video), "r", format="mp4") as container:
        for frame in container.decode(video=0):
            yield np.asarray(frame.to_ndarray(format=PIXEL_FORMAT), dtype=np.uint8)[: frame.height]
