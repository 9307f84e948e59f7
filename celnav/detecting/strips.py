"""Division of large images into pieces that stay in the processor's cache during processing."""

from __future__ import annotations

from collections.abc import Iterator

_BYTES = 1 << 18
_FEWEST_ROWS, _MOST_ROWS = 8, 64


def strips(height: int, width: int) -> Iterator[tuple[int, int]]:
    """Yield the first row, and the row after the last, of strips of a single-precision image."""
    rows = min(max(_BYTES // (4 * width), _FEWEST_ROWS), _MOST_ROWS)
    for top in range(0, height, rows):
        yield top, min(top + rows, height)
