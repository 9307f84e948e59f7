"""A video camera's exposure: its frames, coded and decoded, as a stack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import FramePlan
from generator.frame.video.codec import decode, encode, grey
from generator.frame.video.exposures import video_frames
from generator.frame.video.stack import fits_bytes, stack
from generator.scenario.processing.video_spec import VideoSpec
from generator.seeds import random_stream

STACK_SUFFIX, VIDEO_SUFFIX = "stack.fits", "video.mp4"
CAMERA = "skybench"


@dataclass(frozen=True)
class TakenVideo:
    """Output of a video camera for an exposure.

    Attributes
    ----------
    image : (height, width) uint16 array
        Mean of the frames, 0 to 255; for colour frames, of their luma.
    files : dict of bytes
        Files by suffix: the stack, and the video if it is kept.
    """

    image: NDArray[np.uint16]
    files: dict[str, bytes]


def take_video(plan: FramePlan, spec: VideoSpec) -> TakenVideo:
    """Record the video of a frame; it depends only on the scenario and the frame's index."""
    frames, files = video_frames(plan, spec), {}
    if spec.codec == "h264":
        camera = plan.spec.camera
        video = encode(frames, (camera.height, camera.width), spec.frames_per_s, spec.h264)
        frames = decode(video)
        if spec.keep:
            files[VIDEO_SUFFIX] = video
    else:
        frames = map(grey, frames)
    pile = stack(frames, random_stream(plan.scenario.seed, "video.maximum_frame", plan.index))
    files[STACK_SUFFIX] = fits_bytes(pile, spec.frames_per_s, CAMERA)
    return TakenVideo(pile.mean.astype(np.uint16), files)
