"""The parameters of a camera that a calibration fits: the projection law, and the terms added to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.errors import ConfigError

F8 = NDArray[np.float64]

_MOST_RADIAL = {"brown_conrady": 6, "kannala_brandt": 4}
LAWS = ("pinhole", "brown_conrady", "kannala_brandt", "equidistant", "equisolid", "stereographic", "orthographic")


@dataclass(frozen=True)
class LensForm:
    """Free parameters of a camera.

    Attributes
    ----------
    model : str
        Projection law, one of `LAWS`.
    radial : int
        Number of coefficients k1, k2, ... that are fitted.
    aspect : bool
        Whether the focal length along v is a separate parameter.
    decentring, prism, tilt : bool
        Whether the decentring p1, p2, the thin prism s1..s4, and the sensor tilt tau_x, tau_y are fitted.
    """

    model: str
    radial: int = 0
    aspect: bool = False
    decentring: bool = False
    prism: bool = False
    tilt: bool = False

    def __post_init__(self) -> None:
        if self.model not in LAWS:
            raise ConfigError(f"lens model {self.model!r} is not known; known: {', '.join(LAWS)}")
        if not 0 <= self.radial <= _MOST_RADIAL.get(self.model, 0):
            raise ConfigError(f"lens model {self.model!r} takes no {self.radial} radial coefficients")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return (
            "f_px",
            *(("fy_px",) if self.aspect else ()),
            "cx_px",
            "cy_px",
            *(f"k{i + 1}" for i in range(self.radial)),
            *(("p1", "p2") if self.decentring else ()),
            *(("s1", "s2", "s3", "s4") if self.prism else ()),
            *(("tau_x_rad", "tau_y_rad") if self.tilt else ()),
        )

    @property
    def words(self) -> str:
        """Name of the form for people."""
        added = [
            *([f"{self.radial} radial terms"] if self.radial > 1 else ["1 radial term"] if self.radial else []),
            *(["aspect"] if self.aspect else []),
            *(["decentring"] if self.decentring else []),
            *(["thin prism"] if self.prism else []),
            *(["tilt of the sensor"] if self.tilt else []),
        ]
        return ", ".join([self.model, *added])

    def camera(self, values: F8, size: tuple[int, int]) -> Camera:
        """Make the camera from parameter values, shape (m,), and the `size` (width, height) of the frame."""
        by_name = dict(zip(self.names, values.tolist(), strict=True))

        def group(*names: str) -> tuple[float, ...]:
            return tuple(by_name[name] for name in names if name in by_name)

        return Camera(
            self.model, *size, by_name["f_px"], by_name.get("fy_px", by_name["f_px"]), by_name["cx_px"], by_name["cy_px"],
            k=group(*(f"k{i + 1}" for i in range(self.radial))),
            p=group("p1", "p2"), s=group("s1", "s2", "s3", "s4"), tilt_rad=group("tau_x_rad", "tau_y_rad"),
        )  # fmt: skip

    def values_of(self, camera: Camera) -> F8:
        """Return the parameters of a camera, shape (m,); parameters that the form lacks are left out."""
        padded = {
            "k": (*camera.k, *[0.0] * 6), "p": (*camera.p, 0.0, 0.0), "s": (*camera.s, *[0.0] * 4),
            "tau": (*camera.tilt_rad, 0.0, 0.0),
        }  # fmt: skip
        known = {"f_px": camera.f_px, "fy_px": camera.fy_px, "cx_px": camera.cx_px, "cy_px": camera.cy_px}
        if not self.aspect:
            known["f_px"] = (camera.f_px * camera.fy_px) ** 0.5
        for letter in ("k", "p", "s"):
            known |= {f"{letter}{i + 1}": value for i, value in enumerate(padded[letter])}
        known["tau_x_rad"], known["tau_y_rad"] = padded["tau"][:2]
        return np.array([known[name] for name in self.names])

    def steps(self, values: F8) -> F8:
        """Return the steps of the parameters for numerical derivatives, shape (m,)."""
        f_px = values[0]
        wide = {"f_px": 1e-5 * f_px, "fy_px": 1e-5 * f_px, "cx_px": 1e-2, "cy_px": 1e-2}
        return np.array([wide.get(name, 1e-5) for name in self.names])
