"""What peers that know pinhole cameras only are given: detections as an ideal pinhole of the same focal length sees them."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.protocol import CameraRecord


def undistorted(uv: NDArray[np.float64], camera: CameraRecord) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Positions from the principal point of an ideal pinhole of focal length `camera.f_px`.

    Parameters
    ----------
    uv : ndarray, shape (n, 2)
        Pixels of the camera as it is.
    camera : CameraRecord

    Returns
    -------
    (rows, xy) : ndarray of int, shape (m,), and ndarray, shape (m, 2)
        Detections within 85 degrees of the boresight, which a pinhole can show, and their offsets from the principal
        point, px.
    """
    rays = celnav.Camera.from_dict(dataclasses.asdict(camera)).to_rays(uv)
    rows = np.flatnonzero(np.nan_to_num(rays[:, 2], nan=-1.0) > np.cos(np.radians(85.0)))
    return rows, camera.f_px * rays[rows, :2] / rays[rows, 2:]
