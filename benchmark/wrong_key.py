"""Describe in one sentence what is wrong in a file that people write: the key, what was found and what is expected of it."""

from __future__ import annotations

import difflib
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from generator.scenario.variation import describe

_BOUNDS = {
    "greater_than_equal": ("ge", "at least"),
    "greater_than": ("gt", "above"),
    "less_than_equal": ("le", "at most"),
    "less_than": ("lt", "below"),
}
_WANTED = {
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "dict_type": "a mapping of keys",
    "model_type": "a mapping of keys",
    "finite_number": "a finite number",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "an integer",
    "int_parsing": "an integer",
    "int_from_float": "an integer",
    "list_type": "a list",
    "tuple_type": "a list",
    "string_type": "text, in quotes if it looks like a number",
}


def wrong_key(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """Name the first key that is wrong and what is wrong with it: ``frames: found str 'ten', expected an integer``.

    Parameters
    ----------
    error : ValidationError
    model : type, optional
        Model that was validated; its keys are suggested in place of unknown ones.
    """
    first = error.errors()[0]
    where, kind, context = ".".join(str(part) for part in first["loc"]), first["type"], first.get("ctx", {})
    if kind == "extra_forbidden":
        return f"{where}: unknown key{_suggestion(model, first['loc'])}"
    if kind == "missing":
        return f"{where}: missing"
    if kind == "value_error":
        return f"{where}: {context['error']}" if where else str(context["error"])
    if kind in _BOUNDS:
        limit, words = _BOUNDS[kind]
        expected = f"{words} {context[limit]}"
    else:
        expected = _WANTED.get(kind, first["msg"].removeprefix("Input should be "))
    return f"{where}: found {describe(first['input'])}, expected {expected}"


def _suggestion(model: Any, location: tuple[int | str, ...]) -> str:
    """Name the keys allowed where an unknown key was found, the most similar first."""
    for part in location[:-1]:
        if isinstance(part, str):
            field = getattr(model, "model_fields", {}).get(part)
            model = None if field is None else field.annotation
        models = [kind for kind in (model, *get_args(model)) if isinstance(kind, type) and issubclass(kind, BaseModel)]
        model = models[0] if models else None
    if model is None:
        return ""
    known = [field.alias or name for name, field in model.model_fields.items()]
    close = difflib.get_close_matches(str(location[-1]), known, n=1)
    return (f"; did you mean '{close[0]}'? Allowed: " if close else "; allowed: ") + ", ".join(known)
