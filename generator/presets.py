"""Named values of scenarios: cameras, quantum efficiencies, attitudes, Bortle classes, lamps."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from generator.errors import GeneratorError
from generator.scenario.presets.camera_presets import PRESETS
from generator.scenario.presets.own_values import labelled
from generator.scenario.quantum_efficiency import QE_CURVES
from generator.sky.zenith import BORTLE_ZENITH_MAG

CAMERA, CURVE, ATTITUDE, SKY, LAMP = "camera", "quantum efficiency", "attitude", "sky", "lamp"
KINDS = {
    CAMERA: "camera: {preset: NAME}",
    CURVE: "sensor: {quantum_efficiency: NAME}",
    ATTITUDE: "attitude: NAME",
    SKY: "sky: {bortle: N}",
    LAMP: "sky: {cities: [{lamps: {NAME: SHARE}, …}]}",
}
"""Kinds of names, and how a scenario uses one."""
_OWN = "skybench's own, generic"
_CURVE_TITLES = {
    "cmos-mono": "Back-illuminated monochrome CMOS",
    "cmos-mono-front": "Front-illuminated monochrome CMOS with a global shutter, 70 % at 545 nm",
    "cmos-red": "Red Bayer filter on cmos-mono, infrared cut at 700 nm",
    "cmos-green": "Green Bayer filter on cmos-mono, infrared cut at 700 nm",
    "cmos-blue": "Blue Bayer filter on cmos-mono, infrared cut at 700 nm",
}
_ATTITUDE_TITLES = {"zenith-north-up": "Boresight at the zenith, north at the image's top, east on its left"}
_LAMP_TITLES = {
    "HPS": "High-pressure sodium",
    "LED": "White LED, YAG phosphor",
    "LED3000": "White LED, phosphor PHOS-1",
    "MH": "Metal halide",
    "mercury": "Mercury vapour",
}
_LAMP_SOURCE = "colour-science, SDS_LIGHT_SOURCES (BSD-3-Clause); THIRD_PARTY.md"
_BORTLE_SOURCE = (
    "skybench's convention (docs/physics.md): published zenith brightnesses of Bortle classes differ by about 1 mag for "
    "classes 4 to 9"
)


@dataclass(frozen=True)
class Named:
    """A name of the scenario language.

    Attributes
    ----------
    name : str
        Name as `preset_named` accepts it.
    kind : str
        One of `KINDS`.
    title : str
    source : str
        Source of the values.
    """

    name: str
    kind: str
    title: str
    source: str


@dataclass(frozen=True)
class Preset:
    """A name with its values.

    Attributes
    ----------
    named : Named
    values : mapping of str to object
        Values that the name sets, in the form of a scenario.
    defaults : mapping of str to object
        For a camera: the keys of the scenario's sections ``camera`` and ``sensor`` that the name does not set, with
        their defaults; keys without a value are omitted.
    """

    named: Named
    values: dict[str, Any]
    defaults: dict[str, Any]


def all_named() -> tuple[Named, ...]:
    """Return every name, ordered by kind."""
    cameras = [
        Named(name, CAMERA, preset.title, f"{preset.source} {labelled(name)}") for name, preset in PRESETS.items()
    ]
    curves = [Named(name, CURVE, _CURVE_TITLES[name], _OWN) for name in QE_CURVES]
    attitudes = [
        Named(name, ATTITUDE, title, "definition (docs/conventions.md)") for name, title in _ATTITUDE_TITLES.items()
    ]
    skies = [
        Named(
            f"bortle-{bortle}",
            SKY,
            f"Bortle class {bortle}: zenith of {mag:g} V mag/arcsec^2",
            _BORTLE_SOURCE,
        )
        for bortle, mag in BORTLE_ZENITH_MAG.items()
    ]
    lamps = [Named(name, LAMP, title, _LAMP_SOURCE) for name, title in _LAMP_TITLES.items()]
    return (*cameras, *curves, *attitudes, *skies, *lamps)


def preset_named(name: str) -> Preset:
    """Return the values of a name.

    Raises
    ------
    GeneratorError
        There is no such name; the message lists those that exist.
    """
    listed = {named.name: named for named in all_named()}
    if name not in listed:
        raise GeneratorError(f"unknown preset {name!r}; known: {', '.join(listed)}")
    named = listed[name]
    if named.kind == CAMERA:
        values: dict[str, Any] = {"camera": PRESETS[name].camera, "sensor": PRESETS[name].sensor}
        return Preset(named, values, _defaults_beside(name))
    return Preset(named, _values(named), {})


def _defaults_beside(name: str) -> dict[str, Any]:
    """Return the values of a camera's two sections that its preset leaves to skybench's defaults."""
    from generator.scenario.model import FrameSpec

    anywhere = {
        "site": {"latitude_deg": 0, "longitude_deg": 0},
        "time": {"utc_start": "2020-01-01T00:00:00Z", "exposure_s": 1},
        "camera": {"preset": name},
    }
    whole = FrameSpec.model_validate(anywhere).model_dump(mode="json", by_alias=True, exclude_none=True)
    given = {"camera": {"preset": name} | PRESETS[name].camera, "sensor": PRESETS[name].sensor}
    return {part: _without(whole[part], given[part]) for part in given}


def _without(whole: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """Return the tree `whole` without the leaves of `given`."""
    left = {}
    for key, value in whole.items():
        if isinstance(value, dict) and isinstance(given.get(key), dict):
            if rest := _without(value, given[key]):
                left[key] = rest
        elif key not in given:
            left[key] = value
    return left


def _values(named: Named) -> dict[str, Any]:
    if named.kind == CURVE:
        return {"quantum_efficiency": QE_CURVES[named.name]}
    if named.kind == ATTITUDE:
        from generator.scenario.model import NAMED_ATTITUDES

        return {"attitude": NAMED_ATTITUDES[named.name].model_dump()}
    if named.kind == SKY:
        from generator.sky.city_light import bortle_layout

        bortle = int(named.name.removeprefix("bortle-"))
        cities = [dataclasses.asdict(city) | {"lamps": dict(city.lamps)} for city in bortle_layout(bortle)]
        return {"zenith_mag_arcsec2": BORTLE_ZENITH_MAG[bortle], "cities": cities}
    from generator.light.lamps import lamp_spectra
    from generator.light.photometry import GRID_NM

    spectrum = zip(GRID_NM.tolist(), lamp_spectra()[named.name].tolist(), strict=True)
    return {"photons_per_nm": [(nm, round(relative, 6)) for nm, relative in spectrum]}
