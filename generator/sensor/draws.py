"""Normal and Poisson numbers for all pixels at once, drawn by Dr.Jit on whatever device renders.

The numbers come from Philox 4x32 with ten rounds, a counter-based generator: a stream's key and a pixel's index determine
the pixel's number, which is therefore the same for any number of threads. Source: Salmon et al. 2011, "Parallel random
numbers: as easy as 1, 2, 3", SC11. The key is the first 64-bit number of the stream's NumPy generator.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator import mitsuba_runtime
from generator.device_arrays import aligned

Floats = NDArray[np.float32]

ROUNDS = 10
WORDS = 4
"""Number of 32-bit numbers that Philox generates at once."""
NORMALS, UNIFORMS = 0, 1
"""Second word of Philox' counter, which makes normal and uniform numbers of one stream independent."""
ADDRESSED = 1 << 16
"""Flag in the third word of Philox' counter, which is 0 in streams: numbers by address are independent of theirs."""
SMALLEST_MEAN_BY_NORMAL = 20.0
"""Mean below which Poisson numbers are found by adding up probabilities."""
MOST_KEPT = 1 << 22
"""Largest number of values of a fixed pattern that is cached between frames, 17 MB."""

# Coefficients, constant term first, of the terms in mean^(-k/2) of the series in `poisson_excess`.
_SERIES = (
    (1 / 3, 0, 1 / 6),
    (0, -1 / 36, 0, -1 / 72),
    (-8 / 405, 0, 7 / 810, 0, 1 / 270),
    (0, 671 / 38880, 0, -137 / 38880, 0, -23 / 17280),
    (-16 / 25515, 0, -5189 / 408240, 0, 5 / 3024, 0, 19 / 34020),
)


def standard_normal(shape: tuple[int, ...], stream: np.random.Generator) -> Floats:
    """Normal numbers of mean 0 and variance 1.

    Box and Muller's method (1958, Ann. Math. Statist. 29, 610) is applied to 32-bit numbers, so none is beyond 6.8.
    """
    return normal_numbers(stream_key(stream), shape)


def normal_numbers(key: int, shape: tuple[int, ...]) -> Floats:
    """Return the numbers of :func:`standard_normal` for the key of their stream."""
    return np.array(_normals(key, math.prod(shape))).reshape(shape)


def fixed_normal(shape: tuple[int, ...], stream: np.random.Generator) -> Floats:
    """Return :func:`standard_normal` for a stream that is the same in all frames of a sensor; cached, not to be modified."""
    key = stream_key(stream)
    return _kept_normal(key, shape) if math.prod(shape) <= MOST_KEPT else normal_numbers(key, shape)


_kept_normal = functools.lru_cache(maxsize=4)(normal_numbers)


def poisson(mean: ArrayLike, shape: tuple[int, ...], stream: np.random.Generator) -> Floats:
    """Draw Poisson numbers.

    For means below SMALLEST_MEAN_BY_NORMAL, probabilities are added up in double precision until they exceed a 32-bit
    uniform number. For larger means, the numbers are the Poisson quantile of a normal number (:func:`poisson_excess`),
    rounded down.

    Parameters
    ----------
    mean : array_like
        Mean of each pixel, in single precision; broadcast to `shape`.
    shape : tuple of int
    stream : numpy.random.Generator

    Returns
    -------
    (shape) float32 array
        Poisson numbers, integers.

    Raises
    ------
    ValueError
        A mean is negative or not a number.
    """
    mi = mitsuba_runtime.start()
    import drjit as dr

    means = np.asarray(mean, dtype=np.float32)
    lowest, highest = float(means.min()), float(means.max())
    if not lowest >= 0:
        raise ValueError("the mean of a Poisson number is negative or not a number")
    size, key = math.prod(shape), stream_key(stream)
    expected = mi.Float(aligned(np.broadcast_to(means, shape).ravel())) if means.ndim else dr.opaque(mi.Float, lowest)
    if highest < SMALLEST_MEAN_BY_NORMAL:
        counts = _added_up(expected, size, key)
    else:
        normal = _normals(key, size)
        whole = dr.floor(expected)
        # The integer part is added separately, so that single precision has room for fractions of an electron.
        beyond = expected - whole + poisson_excess(dr.maximum(expected, SMALLEST_MEAN_BY_NORMAL), normal, dr.sqrt)
        counts = dr.maximum(whole + dr.floor(beyond), 0)
        if lowest < SMALLEST_MEAN_BY_NORMAL:
            small = expected < SMALLEST_MEAN_BY_NORMAL
            counts = dr.select(small, _added_up(dr.select(small, expected, 0), size, key), counts)
    return np.array(counts).reshape(shape)


def uniform_at(key: int, first: NDArray[np.int64], second: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """Uniform numbers by address: `count` from 0 to 1 for each pair of integers, the same in every call.

    Parameters
    ----------
    key : int
        Key, below 2^64.
    first, second : (n,) arrays
        Addresses: `first` below 2^32, `second` between -2^47 and 2^47.

    Returns
    -------
    (count, n) array
    """
    mi = mitsuba_runtime.start()
    import drjit as dr
    from drjit import cuda, llvm

    device = cuda if dr.backend_v(mi.Float) == dr.JitBackend.CUDA else llvm
    if not len(first):
        return np.zeros((count, 0))
    shifted = second + (1 << 47)
    seed: Any = dr.opaque(mi.UInt64, key)
    blocks = []
    for block in range(-(-count // WORDS)):
        words = (first, shifted & 0xFFFFFFFF, (shifted >> 32) + ADDRESSED * (1 + block))
        counter = [mi.UInt32(aligned(word.astype(np.uint32))) for word in words]
        drawn = device.Philox4x32(seed, *counter, ROUNDS).next_uint32x4()
        dr.eval(drawn)
        blocks += [np.array(word) for word in drawn]
    return (np.stack(blocks[:count]) + 0.5) * 2.0**-32


def poisson_excess(mean: Any, normal: Any, sqrt: Any) -> Any:
    """Difference between a Poisson quantile and the mean, from the quantile of a normal number.

    The Poisson distribution is that of floor(x) for a continuous x with P(x < n) = P(N < n) = Q(n, mean), the regularised
    incomplete gamma function, for all n > 0, integer or not. Its quantile is a series in the square root of the mean:
    that of M. Giles 2016, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function", ACM
    TOMS 42, 7, with two more terms (which follow from the differential equation that Q imposes on x). Summed over all
    counts, the probabilities differ from Poisson's by less than 4e-6 for means of 20 and more (a total variation of
    2e-6), and by less for larger means.

    Parameters
    ----------
    mean : Float or array
        Mean, at least SMALLEST_MEAN_BY_NORMAL.
    normal : Float or array
        Quantile of the standard normal distribution.
    sqrt : callable
        Square root for numbers of that kind.
    """
    root = sqrt(mean)
    inverse = 1 / root
    total = mean * 0
    for terms in reversed(_SERIES):
        value = normal * 0
        for coefficient in reversed(terms):
            value = value * normal + coefficient
        total = total * inverse + value
    return total + root * normal


def stream_key(stream: np.random.Generator) -> int:
    """Return Philox' key for a fresh stream."""
    return int(stream.integers(0, 1 << 64, dtype=np.uint64))


def _words(key: int, count: int, purpose: int) -> Any:
    """Draw 32-bit random numbers: four UInt32 of `count` entries each."""
    mi = mitsuba_runtime.start()
    import drjit as dr
    from drjit import cuda, llvm

    device = cuda if dr.backend_v(mi.Float) == dr.JitBackend.CUDA else llvm
    seed: Any = dr.opaque(mi.UInt64, key)
    return device.Philox4x32(seed, dr.arange(mi.UInt32, count), purpose, 0, ROUNDS).next_uint32x4()


def _normals(key: int, size: int) -> Any:
    """Draw normal numbers, a Float."""
    mi = mitsuba_runtime.start()
    import drjit as dr

    words = _words(key, -(-size // WORDS), NORMALS)
    numbers = []
    for first, second in ((words[0], words[1]), (words[2], words[3])):
        radius = dr.sqrt(-2 * dr.log((mi.Float(first) + 0.5) * 2**-32))
        sine, cosine = dr.sincos(mi.Float(mi.Int32(second)) * (math.pi * 2**-31))
        numbers += [radius * cosine, radius * sine]
    return _first(mi.Vector4f(*numbers), size)


def _added_up(mean: Any, size: int, key: int) -> Any:
    """Draw Poisson numbers of small means (Float): the smallest whose cumulative probability exceeds a uniform number."""
    mi = mitsuba_runtime.start()
    import drjit as dr

    double: Any = dr.float64_array_t(mi.Float)
    uniform = (double(_first(mi.Vector4u(*_words(key, -(-size // WORDS), UNIFORMS)), size)) + 0.5) * 2**-32
    precise = double(mean)
    probability = dr.exp(-precise)

    def next_count(count: Any, probability: Any, left: Any) -> tuple[Any, Any, Any]:
        probability = probability * precise / (count + 1)
        return count + 1, probability, left - probability

    count, *_ = dr.while_loop(
        (dr.zeros(double, size), probability, uniform - probability),
        lambda count, probability, left: left >= 0,
        next_count,
        ("count", "probability", "left"),
    )
    return mi.Float(count)


def _first(rows: Any, size: int) -> Any:
    """Return the first `size` numbers of vectors, one vector after another."""
    mi = mitsuba_runtime.start()
    import drjit as dr

    numbers = dr.ravel(rows)
    return numbers if dr.width(numbers) == size else dr.gather(type(numbers), numbers, dr.arange(mi.UInt32, size))
