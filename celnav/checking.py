"""Validation of callers' input: numbers, arrays of numbers, and the fields of configurations."""

from __future__ import annotations

import math
import operator
import types
import typing
from dataclasses import MISSING, field, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.errors import CelnavError, ConfigError

# Beyond this, floats do not represent every whole number; no count is as large.
_LARGEST_WHOLE = 2**53
_LONGEST_SHOWN = 40
# Types of the fields of each kind of configuration, looked up once.
_HINTS: dict[type, dict[str, Any]] = {}


def finite_number(
    value: object, what: str, error: type[CelnavError], least: float = -math.inf, most: float = math.inf
) -> float:
    """Return a number as a float; raise `error`, which names `what`, unless it is finite and from `least` to `most`."""
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:  # a whole number beyond the range of floats
            number = math.inf
        if math.isfinite(number) and least <= number <= most:
            return number
    raise error(f"{what} = {shown(value)} must be a finite number{_range_words(least, most)}")


def real_array(values: ArrayLike, what: str, error: type[CelnavError]) -> NDArray[np.float64]:
    """Return numbers as a new array of floats of the same shape; raise `error`, which names `what`, if they are not."""
    try:
        array = np.array(values)
        if np.iscomplexobj(array):
            raise error(f"{what} must be real numbers")
        return array.astype(np.float64)
    except CelnavError:
        raise
    except (TypeError, ValueError, OverflowError):
        raise error(f"{what} must be real numbers, in rows of one length") from None


def real_rows(values: ArrayLike, columns: int, what: str, error: type[CelnavError]) -> NDArray[np.float64]:
    """Return numbers as floats of shape (n, columns), accepting a single row of shape (columns,); raise `error` otherwise."""
    given = isinstance(values, np.ndarray) and values.dtype == np.float64
    array = np.asarray(values) if given else real_array(values, what, error)
    if array.shape[-1:] not in ((columns,), (0,)):
        raise error(f"{what} has shape {array.shape}; it must be (n, {columns})")
    return array.reshape(-1, columns)


def shown(value: object) -> str:
    """Return a short text of any value, for messages."""
    if isinstance(value, int) and abs(value) > _LARGEST_WHOLE:
        return f"{'-' if value < 0 else ''}(a whole number of {value.bit_length()} bits)"
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "…"


def bounded(default: Any = MISSING, least: float = -math.inf, most: float = math.inf) -> Any:
    """Make a dataclass field of a configuration whose numbers must be from `least` to `most`."""
    return field(default=default, metadata={"least": least, "most": most})


def check_fields(config: Any) -> None:
    """Raise `ConfigError` unless each field of a configuration has its declared type and is within its bounds."""
    kind = type(config)
    if kind not in _HINTS:
        _HINTS[kind] = typing.get_type_hints(kind)
    hints = _HINTS[kind]
    for one in fields(config):
        value = getattr(config, one.name)
        least, most = one.metadata.get("least", -math.inf), one.metadata.get("most", math.inf)
        if not _fits(value, hints[one.name], least, most):
            wanted = _words(hints[one.name]) + _range_words(least, most)
            raise ConfigError(f"{type(config).__name__}: {one.name} = {shown(value)} must be {wanted}")


def _fits(value: object, hint: Any, least: float, most: float) -> bool:
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, one, least, most) for one in inner)
    if origin is Literal:
        return isinstance(value, str) and value in inner
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return len(kinds) == len(value) and all(
            _fits(one, kind, least, most) for one, kind in zip(value, kinds, strict=True)
        )
    if hint is int:
        if not isinstance(value, (int, np.integer)) or isinstance(value, bool):
            return False
        whole = operator.index(value)
        return abs(whole) <= _LARGEST_WHOLE and least <= whole <= most
    if hint is float:
        try:
            finite_number(value, "", ConfigError, least, most)
        except ConfigError:
            return False
        return True
    return isinstance(value, hint)


def _words(hint: Any) -> str:
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_words(one) for one in inner)
    if origin is Literal:
        return "one of " + ", ".join(str(one) for one in inner)
    if origin is tuple:
        return f"a tuple of {len(inner)} numbers" if inner[-1] is not Ellipsis else "a tuple"
    named = {int: "a whole number", float: "a finite number", bool: "True or False", type(None): "None"}
    return named.get(hint, f"a {hint.__name__}")


def _range_words(least: float, most: float) -> str:
    if math.isinf(least) and math.isinf(most):
        return ""
    if math.isinf(most):
        return f", {least:g} or more"
    return f" from {least:g} to {most:g}"
