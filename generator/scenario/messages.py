"""Messages about scenario files: the key path, what was found and what is allowed, in one line each."""

from __future__ import annotations

import difflib
import re
from typing import Any, get_args

from pydantic import BaseModel

from generator.scenario.sequences.sequence import SequenceSpec
from generator.scenario.variation import DISTRIBUTION_KEYS, SWEEP_KEY, describe

HEADER_KEYS = ("name", "description", "seed", "frames")
_UNIT_SUFFIX = re.compile(
    r"_(deg_sqrt_h|deg_h_sqrt_h|m_s_sqrt_h|ug_sqrt_h|deg_h|ug|hz|deg|rad|arcsec|arcmin|nm|um|mm|cm|m|km|s|ms|us|min|h|px|e|e_s|dn|mag|hpa|pa|mbar|c|k|f|du)$"
)


def message(problem: Any, source: str) -> str:
    """Format a message in one line: file, key path, what was found, what is allowed."""
    # Tags of alternatives for one value start with #.
    location = tuple(part for part in problem["loc"] if not str(part).startswith("#"))
    where = ".".join(str(part) for part in location)
    kind, context = problem["type"], problem.get("ctx", {})
    if kind == "extra_forbidden":
        return f"{source}: {where}: unknown key{_suggestion(location)}"
    if kind == "missing":
        section = ".".join(str(part) for part in location[:-1])
        return f"{source}: {where}: missing; {section or 'every scenario'} needs it"
    if kind == "value_error":
        return f"{source}: {where}: {context['error']}" if where else f"{source}: {context['error']}"
    bounds = {"greater_than_equal": ("ge", ">="), "greater_than": ("gt", ">"), "less_than_equal": ("le", "<="),
              "less_than": ("lt", "<")}  # fmt: skip
    if kind in bounds:
        limit, sign = bounds[kind]
        expected = f"a value {sign} {context[limit]}"
    elif kind in ("too_short", "too_long"):
        most, limit = ("at least", "min_length") if kind == "too_short" else ("at most", "max_length")
        expected = f"{most} {context[limit]} of them"
    else:
        expected = problem["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    unit = _UNIT_SUFFIX.search(str(location[-1])) if location else None
    if isinstance(problem["input"], str) and unit and kind.startswith(("float", "int")):
        expected += f" in {unit.group(1)}, without a unit of its own"
    return f"{source}: {where}: found {describe(problem['input'])}, expected {expected}{_varying(problem['input'])}"


def _varying(found: Any) -> str:
    """Describe how a value varies, where a mapping replaces a plain value."""
    if not isinstance(found, dict):
        return ""
    keys = (SWEEP_KEY, *DISTRIBUTION_KEYS)
    close = [match for key in found for match in difflib.get_close_matches(str(key), keys, n=1)]
    meant = f"; did you mean '{close[0]}'? A" if close else "; a"
    return f"{meant} value that varies has one of: {', '.join(keys)}"


def _suggestion(location: tuple[Any, ...]) -> str:
    """Name the keys allowed where an unknown key was found, the most similar first."""
    # Its keys include those of an independent frame.
    model: Any = SequenceSpec
    for part in location[:-1]:
        fields = getattr(model, "model_fields", {})
        model = fields[part].annotation if part in fields else None
        choices = [choice for choice in get_args(model) if isinstance(choice, type) and issubclass(choice, BaseModel)]
        model = choices[0] if choices else model
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        return ""
    known = [field.alias or name for name, field in model.model_fields.items()]
    if model is SequenceSpec:
        known += HEADER_KEYS
    wanted = str(location[-1])
    stem = _UNIT_SUFFIX.sub("", wanted)
    for key in known:
        if _UNIT_SUFFIX.sub("", key) == stem and key != wanted:
            unit = _UNIT_SUFFIX.search(key)
            return f"; this quantity is '{key}'" + (f", in {unit.group(1)}" if unit else ", without a unit")
    close = difflib.get_close_matches(wanted, known, n=1)
    return (f"; did you mean '{close[0]}'? Allowed: " if close else "; allowed: ") + ", ".join(known)
