"""Frames of any lens as a pinhole shows them, for programs that only support pinholes (`lens: pinhole` in solver.yaml)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import map_coordinates, spline_filter

import celnav
from benchmark.frames.dataset import Frame, load_image
from benchmark.judge.answers import Response
from benchmark.protocol import Answer, CameraRecord, Detections
from benchmark.solvers.detected_points import Points
from benchmark.solvers.pinhole import pinhole_view

_ROWS = 16
"""Rows that are resampled at a time: their rays stay in a processor's cache."""


@dataclass(frozen=True)
class PinholeFrame:
    """A frame as a pinhole shows it, and the transformation back.

    Attributes
    ----------
    frame : Frame
        The frame with a pinhole camera whose principal point is in the middle.
    shared : Detections or None
        Those of the given detections that the pinhole shows, in its pixels.
    whole : Frame
        The frame with the original camera.
    rows : ndarray of int, shape (n,)
        Indices of these detections among the given ones.
    """

    frame: Frame
    shared: Detections | None
    whole: Frame
    rows: NDArray[np.intp]

    def write_image(self, path: Path) -> None:
        """Resample the image to the pinhole, by cubic splines, which leave its noise nearly as it is.

        Pixels that the frame does not show have the median of the others: a detector that sets one threshold by the
        standard deviation of a whole picture finds next to nothing in one with a black edge.

        Raises OSError.
        """
        pinhole = self.frame.observation.camera
        pixels = load_image(self.whole).astype(np.float32)
        coefficients = spline_filter(pixels, order=3, output=np.float32)
        bounds = np.array(pixels.shape[::-1])
        seen = np.full((pinhole.height, pinhole.width), np.nan, dtype=np.float32)
        columns = np.arange(pinhole.width, dtype=np.float64)
        for first in range(0, pinhole.height, _ROWS):
            rows = np.arange(first, min(first + _ROWS, pinhole.height), dtype=np.float64)
            uv = self.to_lens(np.column_stack((np.tile(columns, len(rows)), np.repeat(rows, len(columns)))))
            with np.errstate(invalid="ignore"):
                shown = ((uv > -1.0) & (uv < bounds)).all(axis=1)
            part = seen[first : first + len(rows)].reshape(-1)
            part[shown] = map_coordinates(coefficients, uv[shown, ::-1].T, order=3, mode="nearest", prefilter=False)
        beyond = np.isnan(seen)
        if beyond.any():
            seen[beyond] = 0.0 if beyond.all() else np.median(seen[~beyond])
        values = np.clip(np.round(seen), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        Image.fromarray(values).save(path, format="PNG", compress_level=1)

    def to_lens(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform pixels of the pinhole to pixels of the original camera, shape (n, 2); NaN where it shows nothing."""
        rays = _camera(self.frame.observation.camera).to_rays(uv)
        return np.asarray(_camera(self.whole.observation.camera).project(rays))

    def back(self, response: Response, shared: Detections | None) -> Response:
        """Transform a program's response to the pixels of the original camera and the indices of the original detections."""
        if shared is None:
            uv = self.to_lens(response.uv) if len(response.uv) else response.uv
            kept = np.flatnonzero(np.isfinite(uv).all(axis=1))
            return dataclasses.replace(
                response, answer=_renumbered(response.answer, kept), uv=uv[kept], flux=response.flux[kept]
            )
        if not len(response.uv):  # a failure has no detections
            return response
        matches = response.answer.matches.copy()
        matches[:, 0] = self.rows[matches[:, 0]]
        flux = np.full(len(shared.uv), np.nan) if shared.flux is None else np.array(shared.flux, dtype=np.float64)
        answer = dataclasses.replace(response.answer, matches=matches)
        return dataclasses.replace(response, answer=answer, uv=np.array(shared.uv, dtype=np.float64), flux=flux)


def _renumbered(answer: Answer, kept: NDArray[np.intp]) -> Answer:
    """Renumber matches, keeping those whose detections are kept."""
    matches = answer.matches[np.isin(answer.matches[:, 0], kept)].copy()
    matches[:, 0] = np.searchsorted(kept, matches[:, 0])
    return dataclasses.replace(answer, matches=matches)


def is_centred_pinhole(camera: CameraRecord) -> bool:
    """Whether a camera is an ideal pinhole with its principal point in the middle."""
    middle = (camera.width - 1) / 2.0, (camera.height - 1) / 2.0
    ideal = camera.model == "pinhole" and not any((*camera.k, *camera.p, *camera.s, *camera.tilt_rad))
    return ideal and camera.fy_px == camera.f_px and (camera.cx_px, camera.cy_px) == middle


def as_pinhole(frame: Frame, shared: Detections | None) -> PinholeFrame:
    """Transform a frame, and detections where given, to a pinhole of the same focal length."""
    lens = frame.observation.camera
    view = pinhole_view(np.empty((0, 2)) if shared is None else np.asarray(shared.uv), lens)
    middle = np.array([(view.width - 1) / 2.0, (view.height - 1) / 2.0])
    camera = CameraRecord("pinhole", view.width, view.height, view.f_px, view.f_px, *middle)
    shown = dataclasses.replace(frame, observation=dataclasses.replace(frame.observation, camera=camera))
    points = None
    if shared is not None:
        points = Points(middle + view.xy, None if shared.flux is None else np.asarray(shared.flux)[view.rows])
    return PinholeFrame(shown, points, frame, view.rows)


def _camera(record: CameraRecord) -> celnav.Camera:
    return celnav.Camera.from_dict(dataclasses.asdict(record))
