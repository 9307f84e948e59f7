"""Everything that ``skybench speed`` measures, in one report."""

from __future__ import annotations

import platform
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from generator.mitsuba_runtime import CUDA_VARIANT, choose_variant
from generator.speed.load import Load, cores, load_average, one_thread
from generator.speed.pairs import PairedTimes, time_cameras, time_everything, time_skies
from generator.speed.scenes import FrameSize
from generator.speed.stages import time_stages
from generator.speed.throughput import frames_per_second

FORMAT = "skybench-speed/1"
LIMITED = ("floor", "sky", "camera", "everything")
"""Names of the ratios that can be compared with a limit."""
PART_OF = "of which"
"""Prefix of stages that are parts of the preceding stage."""


@dataclass(frozen=True)
class SpeedReport:
    """Results of the measurement.

    Attributes
    ----------
    device : str
        Device on which Dr.Jit computes.
    variant : str
        Variant of Mitsuba.
    size : FrameSize
    codec : str
    stages_s, floor_s : dict of float
        Median seconds by stage, one frame at a time in one process.
    frames_per_s : dict of float
        Frames per second by number of worker processes.
    sky, camera, everything : PairedTimes
        Times of full against plain frames.
    load : Load
        Load of the machine meanwhile.
    """

    device: str
    variant: str
    size: FrameSize
    codec: str
    stages_s: dict[str, float]
    floor_s: dict[str, float]
    frames_per_s: dict[int, float]
    sky: PairedTimes
    camera: PairedTimes
    everything: PairedTimes
    load: Load

    @property
    def frame_s(self) -> float:
        """Sum of the stages, s."""
        return sum(seconds for name, seconds in self.stages_s.items() if not name.startswith(PART_OF))

    @property
    def over_floor(self) -> float:
        """A frame's time relative to the floor's."""
        return self.frame_s / sum(self.floor_s.values())

    @property
    def scaling(self) -> float:
        """Frames per second with the most processes relative to those with one."""
        return self.frames_per_s[max(self.frames_per_s)] / self.frames_per_s[1]

    @property
    def limited(self) -> dict[str, float]:
        """The ratios of LIMITED; the smaller the better."""
        ratios = (self.over_floor, self.sky.ratio, self.camera.ratio, self.everything.ratio)
        return dict(zip(LIMITED, ratios, strict=True))

    def as_json(self) -> dict[str, Any]:
        """The report as JSON-ready data."""
        return {
            "format": FORMAT,
            "device": self.device,
            "variant": self.variant,
            "frame": asdict(self.size),
            "codec": self.codec,
            "stages_s": self.stages_s,
            "frame_s": self.frame_s,
            "floor_s": self.floor_s,
            "over_floor": self.over_floor,
            "frames_per_s": {str(workers): rate for workers, rate in self.frames_per_s.items()},
            "scaling": self.scaling,
            "sky": asdict(self.sky) | {"ratio": self.sky.ratio},
            "camera": asdict(self.camera) | {"ratio": self.camera.ratio},
            "everything": asdict(self.everything) | {"ratio": self.everything.ratio},
            "load": asdict(self.load),
        }


def measure(
    frames: int,
    pairs: int,
    workers: tuple[int, ...] = (1, 2),
    size: FrameSize | None = None,
    codec: str = "png",
    progress: Callable[[str], None] = lambda stage: None,
) -> SpeedReport:
    """Measure everything.

    Parameters
    ----------
    frames : int
        Number of frames to time for the stages, and per worker process.
    pairs : int
        Number of pairs of frames for each of the three ratios.
    workers : tuple of int
        Numbers of processes; 1 is the base of the scaling.
    size : FrameSize, optional
    codec : str
        Codec of the images: ``png`` or ``jxl``.
    progress : callable
        Called with the name of the next measurement.
    """
    size = size or FrameSize()
    before = load_average()
    started, used = time.perf_counter(), time.process_time()
    with one_thread():
        progress("stages")
        stages, floor = time_stages(frames, size, codec)
        progress("skies")
        sky = time_skies(pairs, size)
        progress("cameras")
        camera = time_cameras(pairs, size)
        progress("everything")
        everything = time_everything(pairs, size)
    share = (time.process_time() - used) / (time.perf_counter() - started)
    rates = {}
    for count in workers:
        progress(f"{count} {'process' if count == 1 else 'processes'}")
        rates[count] = frames_per_second(count, frames, size, codec)
    variant = choose_variant()
    load = Load(cores(), before, load_average(), share)
    return SpeedReport(device_name(variant), variant, size, codec, stages, floor, rates, sky, camera, everything, load)


def device_name(variant: str) -> str:
    """Name of the device of a Mitsuba variant: the first GPU, or the processor."""
    if variant == CUDA_VARIANT:
        query = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
        try:
            run = subprocess.run(query, capture_output=True, text=True, timeout=20, check=True)
        except (OSError, subprocess.SubprocessError):
            return "GPU of unknown name"
        return (run.stdout.splitlines() or ["GPU of unknown name"])[0].strip()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()
