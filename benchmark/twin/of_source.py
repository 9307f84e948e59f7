"""The twin of a photograph that is not read yet, whatever its kind: a still picture or a stack of video."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmark.photographed.view import not_sky_of
from benchmark.twin.given_files import check_mask
from benchmark.twin.render_twin import make_twin
from benchmark.twin.scene import Scene
from benchmark.twin.sources import Source
from benchmark.twin.twin import Twin
from benchmark.twin.video_twin import make_video_twin


def twin_of(
    scene: Scene, source: Source, folder: Path, mask: Path | None = None, passing: Sequence[dict[str, Any]] = ()
) -> Twin:
    """Read a photograph, make its twin and compare the two; the twin's scenario is written to `folder`.

    Parameters
    ----------
    scene : Scene
    source : Source
    folder : Path
    mask : Path, optional
        Picture whose dark pixels are not sky.
    passing : sequence of dict
        Trails that the twin also has; nothing is fitted to them.

    Raises
    ------
    PhotographError
        The photograph or the mask cannot be used.
    """
    if mask is not None:
        check_mask(mask)
    own, photograph = source.read(scene)
    hidden = None if mask is None else not_sky_of(mask, own.camera)
    video = photograph.mean_of_video or own.spec.sensor.video is not None
    make = make_video_twin if video else make_twin
    return make(own, photograph, folder, not_sky=hidden, passing=passing)
