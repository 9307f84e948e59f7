"""The published JSON schema of scenario files, made from the models that validate them."""

from __future__ import annotations

from typing import Any

from generator.scenario.messages import HEADER_KEYS
from generator.scenario.model import TimeSpec
from generator.scenario.sequences.sequence import SequenceSpec

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NUMBERS = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}

_VARIED = {"$ref": "#/$defs/Variation"}
_VARIATION: dict[str, Any] = {
    "description": "A value that varies over the frames: a sweep or a distribution.",
    "type": "object",
    "oneOf": [
        {
            "required": ["sweep"],
            "properties": {"sweep": {"type": "array", "minItems": 1}, "zip": {"type": "string"}},
            "additionalProperties": False,
        },
        {"required": ["uniform"], "properties": {"uniform": _NUMBERS}, "additionalProperties": False},
        {
            "required": ["integer"],
            "properties": {"integer": _NUMBERS | {"items": {"type": "integer"}}},
            "additionalProperties": False,
        },
        {
            "required": ["normal"],
            "properties": {"normal": _NUMBERS, "limits": _NUMBERS},
            "additionalProperties": False,
        },
        {
            "required": ["choice"],
            "properties": {"choice": {"type": "array", "minItems": 1}},
            "additionalProperties": False,
        },
        {"required": ["sphere_latitude"], "properties": {"sphere_latitude": _NUMBERS}, "additionalProperties": False},
        {
            "required": ["utc"],
            "properties": {
                "utc": {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2},
                "sun_below_deg": {"type": "number"},
            },
            "additionalProperties": False,
        },
    ],
}


def scenario_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a scenario file.

    Every value may also be a variation (sweep or distribution); names of curves and attitudes are accepted wherever the
    models accept them. The schema is for editors; ``skybench plan`` validates completely.
    """
    sequence = SequenceSpec.model_json_schema()
    definitions = {name: _with_variations(model) for name, model in sequence.pop("$defs").items()}
    definitions["Variation"] = _VARIATION
    # An independent frame has a subset of the keys of a sequence.
    frame_time = definitions["SequenceTimeSpec"]
    frame_time["required"] = [key for key in frame_time["required"] if key in TimeSpec.model_fields]
    frame_time["dependentRequired"] = {"every_s": ["count"], "count": ["every_s"]}
    # A named camera supplies the keys that are required otherwise.
    camera = definitions["CameraSpec"]
    camera["anyOf"] = [{"required": camera.pop("required")}, {"required": ["preset"]}]
    schema = _with_variations(sequence)
    header = {
        "name": {"type": "string", "pattern": "^[a-z0-9][a-z0-9_-]{0,63}$", "description": "Name of the scenario."},
        "description": {"type": "string", "description": "For people."},
        "seed": {
            "type": "integer",
            "minimum": 0,
            "maximum": 2**64 - 1,
            "default": 0,
            "description": "Root of all randomness.",
        },
        "frames": {
            "type": "integer",
            "minimum": 1,
            "default": 1,
            "description": "Frames, or sequences, per combination of swept values.",
        },
    }
    assert tuple(header) == HEADER_KEYS
    return {
        "$schema": SCHEMA_DIALECT,
        "title": "skybench scenario",
        "type": "object",
        "properties": header | schema["properties"],
        "required": ["name", *schema["required"]],
        "anyOf": [{"required": ["site"]}, {"required": ["path"]}],
        "additionalProperties": False,
        "$defs": definitions,
    }


def _with_variations(model: dict[str, Any]) -> dict[str, Any]:
    """Let each property of a model be a variation, or the name of something (a curve, an attitude, a file)."""
    if "properties" not in model:
        return model
    properties = {}
    for name, found in model["properties"].items():
        notes = {key: found[key] for key in ("description", "title", "default") if key in found}
        value = {key: item for key, item in found.items() if key not in notes}
        named = [{"type": "string"}] if _may_be_named(value) else []
        properties[name] = {**notes, "anyOf": [_with_varied_items(value), *named, _VARIED]}
    return model | {"properties": properties}


def _with_varied_items(value: dict[str, Any]) -> dict[str, Any]:
    """Let each item of a list, and of the lists in it, be a variation."""
    if "anyOf" in value:
        return value | {"anyOf": [_with_varied_items(option) for option in value["anyOf"]]}
    if value.get("type") != "array":
        return value
    varied = dict(value)
    if isinstance(value.get("items"), dict):
        varied["items"] = {"anyOf": [_with_varied_items(value["items"]), _VARIED]}
    if "prefixItems" in value:
        varied["prefixItems"] = [{"anyOf": [_with_varied_items(item), _VARIED]} for item in value["prefixItems"]]
    return varied


def _may_be_named(value: dict[str, Any]) -> bool:
    """Whether a value is a structure that a scenario may name instead."""
    named = str(value.get("$ref", "")).endswith(("/Pointing", "/InputFile"))
    return named or value.get("type") == "array" or any(_may_be_named(option) for option in value.get("anyOf", ()))
