"""The scene of a fixed camera: a scenario whose place, time, pointing and weather are replaced by a photograph's."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pydantic
import yaml
from numpy.typing import NDArray
from PIL import Image

from benchmark.errors import PhotographError
from benchmark.twin.photograph import Photograph
from celnav.camera import Camera
from generator.files import write_bytes
from generator.reading.strict_yaml import StrictLoader, strict_text
from generator.scenario.file import Scenario, load_scenario, parse_scenario
from generator.scenario.foreground_spec import TrailSpec
from generator.scenario.model import FrameSpec, pointing_of

ANGLE_DIGITS = 6


FLYING = ("trails", "trains", "shells")
"""Keys of a scene's foreground that belong to one moment; twins omit them."""


_PASSING = pydantic.TypeAdapter(dict[str, list[TrailSpec]])
"""Content of a file that lists what flew through photographs, by their names."""


class Conditions(Protocol):
    """Conditions that are fitted to a photograph."""

    def over(self, tree: dict[str, Any]) -> dict[str, Any]:
        """A scenario's tree under these conditions."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A fixed camera.

    Attributes
    ----------
    path : Path
        Path of the scenario.
    scenario : Scenario
    tree : dict
        Its text as read.
    spec : FrameSpec
        Its only frame.
    """

    path: Path
    scenario: Scenario
    tree: dict[str, Any]
    spec: FrameSpec

    @property
    def camera(self) -> Camera:
        """The camera in the form of the solver's package."""
        projection = self.spec.camera.projection
        return Camera(
            model=projection.model,
            width=self.spec.camera.width,
            height=self.spec.camera.height,
            f_px=projection.f_px,
            fy_px=projection.fy_px,
            cx_px=projection.cx_px,
            cy_px=projection.cy_px,
            k=tuple(projection.k),
            p=tuple(projection.p),
            s=tuple(projection.s),
            tilt_rad=tuple(projection.tilt_rad),
        )

    def check_size(self, name: str, shape: tuple[int, ...]) -> None:
        """Raise PhotographError where a photograph's (height, width) is not the camera's."""
        height, width = shape
        if (width, height) != (self.spec.camera.width, self.spec.camera.height):
            raise PhotographError(
                f"{name}: has {width} x {height} pixels, the scene's camera {self.spec.camera.width} x "
                f"{self.spec.camera.height}"
            )

    @property
    def cities(self) -> bool:
        """Whether the scene names its own cities."""
        return bool((self.tree.get("sky") or {}).get("cities"))

    @property
    def landscape(self) -> bool:
        """Whether the scene has a landscape of its own."""
        return bool((self.tree.get("foreground") or {}).get("landscape"))


def read_scene(path: Path) -> Scene:
    """Read the scenario of a fixed camera.

    Raises
    ------
    GeneratorError
        It is not a scenario.
    PhotographError
        It has more than one frame.
    """
    scenario = load_scenario(path)
    if scenario.frame_count != 1:
        raise PhotographError(f"{path}: has {scenario.frame_count} frames; a camera's scene has one")
    tree = yaml.load(path.read_text(encoding="utf-8"), Loader=StrictLoader)  # a SafeLoader underneath
    return Scene(path, scenario, tree, scenario.frame(0))


def read_passing(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Read what flew through photographs: trails of a scenario's foreground, by the photographs' names.

    Raises
    ------
    PhotographError
        The file cannot be read or has other content.
    """
    try:
        given = yaml.load(path.read_text(encoding="utf-8"), Loader=StrictLoader)  # a SafeLoader underneath
        return {
            name: [trail.model_dump(exclude_unset=True) for trail in trails]
            for name, trails in _PASSING.validate_python(given).items()
        }
    except (OSError, UnicodeDecodeError, yaml.YAMLError, pydantic.ValidationError) as error:
        raise PhotographError(
            f"{path}: expected trails of a scenario's foreground by names of photographs ({str(error).splitlines()[0]})"
        ) from None


def changed_scene(scene: Scene, own: dict[str, Any]) -> Scene:
    """The scene with other sections of its scenario.

    Raises
    ------
    GeneratorError
        They do not make a scenario.
    """
    tree = scene.tree | own
    scenario = parse_scenario(_text(tree), str(scene.path))
    return Scene(scene.path, scenario, tree, scenario.frame(0))


def with_passing(tree: dict[str, Any], trails: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Add what flew through a photograph to its twin's scenario."""
    return tree | {"foreground": tree["foreground"] | {"trails": list(trails)}} if trails else tree


def twin_tree(scene: Scene, photograph: Photograph, R_cam: NDArray[np.float64], weather: Conditions) -> dict[str, Any]:
    """The twin's scenario: the scene at the photograph's place and time, with the camera's true attitude, in a weather."""
    scene.check_size(photograph.name, photograph.pixels.shape)
    pointing = pointing_of(R_cam)
    own = {
        "name": f"twin-{photograph.name}",
        "description": f"Twin of the photograph {photograph.name}",
        "seed": sum(photograph.name.encode()),
        "site": {
            "latitude_deg": photograph.latitude_deg,
            "longitude_deg": photograph.longitude_deg,
            "height_m": photograph.height_m,
        },
        "time": {"utc_start": photograph.utc_start, "exposure_s": photograph.exposure_s},
        "attitude": {
            "azimuth_deg": round(pointing.azimuth_deg, ANGLE_DIGITS),
            "altitude_deg": round(pointing.altitude_deg, ANGLE_DIGITS),
            "roll_deg": round(pointing.roll_deg, ANGLE_DIGITS),
        },
    }
    foreground = {key: value for key, value in (scene.tree.get("foreground") or {}).items() if key not in FLYING}
    return weather.over(scene.tree | own | {"foreground": foreground})


def twin_scenario(scene: Scene, tree: dict[str, Any]) -> Scenario:
    """The scenario of a tree, with the scene's files."""
    return parse_scenario(_text(tree), str(scene.path.with_name(f"{tree['name']}.yaml")))


def write_twin(
    scene: Scene, tree: dict[str, Any], folder: Path, ground: NDArray[np.uint8] | None = None
) -> tuple[Path, Scenario]:
    """Write a twin's scenario and the files that it names into a folder; return its path and the scenario.

    `ground` is a landscape of its own (rows, columns, 4) as a fisheye picture.
    """
    path = folder / f"{tree['name']}.yaml"
    for file in scene.scenario.files:
        write_bytes(folder / file.path, Path(file.location).read_bytes())
    if ground is not None:
        picture = folder / f"{tree['name']}-ground.png"
        write_bytes(picture, png_bytes(ground))
        landscape = {"file": picture.name, "projection": "fisheye"}
        tree = tree | {"foreground": tree["foreground"] | {"landscape": landscape}}
    write_bytes(path, _text(tree).encode())
    return path, load_scenario(path)


def png_bytes(picture: NDArray[np.uint8]) -> bytes:
    """A picture (rows, columns, 4) as a PNG file."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def _text(tree: dict[str, Any]) -> str:
    return strict_text(tree, sort_keys=False, allow_unicode=True, width=120)
