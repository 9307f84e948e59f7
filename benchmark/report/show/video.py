"""`skybench show --video`: the frames of a dataset, or of a rendered folder, as an MP4 file."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmark.report.show.source import Source, damage_named, open_source
from benchmark.report.show.truth_overlay import draw_truth
from generator.errors import GeneratorError
from generator.files import atomic_path
from generator.scenario.processing.develop_spec import DevelopSpec
from generator.scenario.sensor_spec import ColourSpec, SensorSpec
from generator.sensor.develop import develop

LARGEST_PX = (3840, 2160)
"""Larger frames are averaged over blocks of pixels, because players do not decode them."""
CODECS = (
    ("libx264", {"crf": "18", "preset": "medium", "threads": "1"}),
    ("mpeg4", {"qscale": "3", "threads": "1"}),
)
"""H.264, or MPEG-4 part 2 where PyAV was built without x264; constant quality. The same frames give the same pictures
to within a few grey levels; x264 does not guarantee the same bytes."""
PIXEL_FORMAT = "yuv420p"
"""The format that every player supports; it requires even sizes."""


def write_video(
    folder: Path,
    out: Path,
    frames_per_s: float,
    truth: bool = False,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> int:
    """Write all frames in order, each as its developed picture; returns their number.

    Frames without a developed picture are developed with automatic exposure.

    Parameters
    ----------
    folder : Path
        A dataset, or a folder of rendered frames.
    out : Path
        An MP4 file; it appears when it is complete.
    frames_per_s : float
        Frames shown per second, 0.1 to 120.
    truth : bool
        Whether to draw time, place, attitude and the brightest stars' names over the pictures.
    progress : callable
        Called with the number of frames written and their total.

    Raises
    ------
    GeneratorError
        The frames cannot be read or differ in size, or the file cannot be written.
    """
    if out.suffix.lower() != ".mp4":
        raise GeneratorError(f"--video {out}: the file's name must end in .mp4")
    if not 0.1 <= frames_per_s <= 120:
        raise GeneratorError(f"--fps {frames_per_s:g}: from 0.1 to 120")
    source = open_source(folder)
    count = len(source.frames)
    if not count:
        raise GeneratorError(f"{folder}: holds no frames; render some with `skybench render`")
    try:
        with atomic_path(out) as temporary:
            _encode(source, folder, temporary, frames_per_s, truth, lambda done: progress(done, count))
    except OSError as error:
        raise GeneratorError(f"{out}: cannot be written ({error.strerror or error}); choose another place") from error
    return count


def _encode(
    source: Source, folder: Path, out: Path, frames_per_s: float, truth: bool, progress: Callable[[int], None]
) -> None:
    # Imported here because it loads FFmpeg, for which other commands need not wait.
    import av

    with av.open(str(out), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        codec, options = next(each for each in CODECS if each[0] in av.codecs_available)
        stream: Any = container.add_stream(codec, rate=Fraction(frames_per_s).limit_denominator(1000), options=options)
        stream.pix_fmt = PIXEL_FORMAT
        size: tuple[int, ...] | None = None
        for position in range(len(source.frames)):
            picture = video_picture(source, position, folder, truth)
            if size is None:
                size = picture.shape
                stream.height, stream.width = picture.shape[:2]
            elif picture.shape != size:
                frame_id = source.frames.iloc[position]["frame_id"]
                raise GeneratorError(
                    f"{folder}: {frame_id} has another size than the frames before it; a video needs frames of one size"
                )
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            progress(position + 1)
        container.mux(stream.encode(None))


def video_picture(source: Source, position: int, folder: Path, truth: bool) -> NDArray[np.uint8]:
    """Picture of the frame in row `position`, (height, width, 3), of even size and at most LARGEST_PX.

    Raises
    ------
    GeneratorError
        The frame is damaged.
    """
    record = source.record(position)
    with damage_named(folder / str(source.frames.iloc[position]["frame_id"])):
        picture = source.developed(position)
        if picture is None:
            picture = _developed(source.image(position), record["sensor"])
        if picture.ndim == 2:
            picture = np.repeat(picture[:, :, None], 3, axis=2)
        reduction = max(
            1, *(math.ceil(size / most) for size, most in zip(picture.shape[1::-1], LARGEST_PX, strict=True))
        )
        if reduction > 1:
            picture = np.array(Image.fromarray(picture).reduce(reduction))
        if truth:
            picture = draw_truth(picture, record, source.stars(position), reduction)
        height, width = picture.shape[:2]
        return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _developed(dn: NDArray[np.uint16], sensor: dict[str, Any]) -> NDArray[np.uint8]:
    """Develop a raw frame with automatic exposure, using the sensor's part of its record."""
    pattern = sensor["bayer_pattern"]
    spec = SensorSpec(
        bits=sensor["bits"],
        black_level_dn=sensor["black_level_dn"],
        colour=None if pattern is None else ColourSpec(pattern=pattern),
        develop=DevelopSpec(exposure="auto"),
    )
    return develop(dn, spec)
