"""``python -m benchmark.solvers.serve NAME``: one of the adapters as a program that speaks docs/solver_protocol.md."""

import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmark.protocol import SIGMAS, CameraRecord, Detections, Observation, SequencePlace, SolverUnderTest
from benchmark.solvers.messages import PROTOCOL
from benchmark.solvers.registry import make_solver
from benchmark.solvers.time_limited import TimeLimited


@dataclass(frozen=True)
class _Given:
    """Detections that a request supplies."""

    uv: NDArray[np.float64]
    flux: NDArray[np.float64] | None


def serve(solver: SolverUnderTest, requests: BinaryIO, replies: BinaryIO) -> None:
    """Answer requests until there are no more."""
    for line in requests:
        request = json.loads(line)
        if request["type"] == "hello":
            reply = {"type": "hello", "protocol": PROTOCOL, "name": solver.name, "version": solver.version}
        else:
            try:
                limited = solver.within(request["time_limit_s"]) if isinstance(solver, TimeLimited) else solver
                answer = answer_request(limited, request)
            except Exception as error:  # a solver may raise anything
                answer = {"status": "error", "reason": f"{type(error).__name__}: {error}"}
            reply = {"type": "fix", "frame_id": request["frame_id"], **answer}
        replies.write(json.dumps(reply).encode() + b"\n")
        replies.flush()


def _camera(fields: Mapping[str, Any]) -> CameraRecord:
    """Read the camera of a request; thin prism and tilt may be missing."""
    lists = {name: tuple(fields.get(name, ())) for name in ("k", "p", "s", "tilt_rad")}
    values: dict[str, Any] = {**fields, **lists}
    return CameraRecord(**values)


def _sequence(fields: Mapping[str, Any] | None) -> SequencePlace | None:
    """Read the place in a sequence from a request; None for a single frame."""
    if fields is None:
        return None
    return SequencePlace(fields["id"], fields["index"], fields["length"], fields["tilt_bias_sigma_deg"])


def answer_request(solver: SolverUnderTest, request: Mapping[str, Any]) -> dict[str, Any]:
    """Detect where no detections are supplied, solve, and convert the answer to the protocol's terms."""
    heading = request["heading_sigma_deg"]
    observation = Observation(
        camera=_camera(request["camera"]),
        utc=request["utc_mid"],
        R_cam=np.array(request["R_cam"], dtype=np.float64),
        tilt_sigma_deg=request["tilt_sigma_deg"],
        heading_sigma_deg=np.inf if heading is None else heading,
        pressure_hpa=request["pressure_hpa"],
        temperature_c=request["temperature_c"],
        **{name: request[name] for name in SIGMAS},
        sequence=_sequence(request.get("sequence")),
    )
    started = time.perf_counter()
    found = _given(request) if request["detections"] is not None else solver.detect(_read(request["image"]))
    detected = time.perf_counter()
    answer = solver.solve(found, observation)
    times = dict(answer.time_ms) | {"detect": 1000.0 * (detected - started)}
    cov = answer.cov_km2
    own = request["detections"] is None
    flux = None if found.flux is None else np.asarray(found.flux).tolist()
    return {
        "status": "fix" if answer.ok else "refused",
        "reason": answer.reason,
        "lat_deg": answer.lat_deg,
        "lon_deg": answer.lon_deg,
        "cov_ee_km2": None if cov is None else float(cov[0, 0]),
        "cov_en_km2": None if cov is None else float(cov[0, 1]),
        "cov_nn_km2": None if cov is None else float(cov[1, 1]),
        "confidence": answer.confidence,
        "matches": answer.matches.tolist(),
        "detections": {"uv": np.asarray(found.uv).tolist(), "flux": flux} if own else None,
        "time_ms": times,
    }


def _read(path: str) -> NDArray[np.uint16]:
    with Image.open(path, formats=["PNG"]) as picture:
        return np.asarray(picture).astype(np.uint16)


def _given(request: Mapping[str, Any]) -> Detections:
    uv = np.array(request["detections"]["uv"], dtype=np.float64).reshape(-1, 2)
    flux = request["detections"]["flux"]
    known = bool(flux) and all(value is not None for value in flux)
    return _Given(uv, np.array(flux, dtype=np.float64) if known else None)


def main() -> None:
    """Serve the solver named on the command line, over standard input and output."""
    # Output printed by a library must not mix with the replies.
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(make_solver(sys.argv[1]), sys.stdin.buffer, replies)


if __name__ == "__main__":
    main()
