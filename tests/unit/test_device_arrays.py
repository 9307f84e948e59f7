"""Arrays where Dr.Jit reads them as its own."""

from __future__ import annotations

import numpy as np

from generator import mitsuba_runtime
from generator.device_arrays import ALIGNMENT, aligned, aligned_zeros


def at_offset(offset: int, count: int = 4000) -> np.ndarray:
    store = np.zeros(4 * count + 2 * ALIGNMENT, np.uint8)
    start = -store.ctypes.data % ALIGNMENT + offset
    values = store[start : start + 4 * count].view(np.float32)
    values[:] = np.arange(count)
    return values


def kernel_texts(values: np.ndarray) -> list[str]:
    """Of a sum with an array and of look-ups of four of its numbers."""
    mi = mitsuba_runtime.start()
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        array = mi.Float(values)
        packets = dr.gather(mi.Vector4f, array, dr.arange(mi.UInt32, len(values) // 4))
        dr.eval(array + 1)
        dr.eval(packets.x + packets.w)
        return [str(kernel["hash"]) for kernel in dr.kernel_history([dr.KernelType.JIT])]


def test_kernels_are_the_same_wherever_numpy_has_an_array() -> None:
    at_multiple, elsewhere = (aligned(at_offset(offset)) for offset in (0, 16))
    np.testing.assert_array_equal(at_multiple, elsewhere)
    assert kernel_texts(at_multiple) == kernel_texts(elsewhere)
    # Without this, they differ.
    assert kernel_texts(at_offset(0)) != kernel_texts(at_offset(16))


def test_arrays_keep_their_values_and_shape() -> None:
    values = np.arange(12.0).reshape(3, 4).T
    result = aligned(values)
    np.testing.assert_array_equal(result, values)
    assert result.ctypes.data % ALIGNMENT == 0
    assert result.flags.c_contiguous
    zeros = aligned_zeros((3, 5), np.float32)
    assert zeros.shape == (3, 5)
    assert zeros.dtype == np.float32
    assert not zeros.any()
    assert zeros.ctypes.data % ALIGNMENT == 0
