"""The size that a JPEG XL image states, read before anything is unpacked (ISO/IEC 18181-1, SizeHeader; 18181-2, boxes)."""

from __future__ import annotations

from fractions import Fraction

from generator.errors import GeneratorError

CODESTREAM = b"\xff\x0a"
CONTAINER = b"\x00\x00\x00\x0cJXL \x0d\x0a\x87\x0a"
_SIDE_BITS = (9, 13, 18, 30)
_WIDTH_OVER_HEIGHT = (
    Fraction(1), Fraction(12, 10), Fraction(4, 3), Fraction(3, 2), Fraction(16, 9), Fraction(5, 4), Fraction(2),
)  # fmt: skip
_HEADER_BYTES = 10
"""Header size: two sides of 32 bits, the ratio and a flag."""


def jxl_shape(data: bytes) -> tuple[int, int]:
    """Height and width (px) that a JPEG XL image states, bare or in a container.

    Raises
    ------
    GeneratorError
        The data are not a JPEG XL image; nothing is unpacked.
    """
    if data.startswith(CONTAINER):
        data = _codestream(data)
    if not data.startswith(CODESTREAM):
        raise GeneratorError("not a JPEG XL image")
    # Numbers are packed starting with the least significant bit.
    bits = _Bits(int.from_bytes(data[2 : 2 + _HEADER_BYTES], "little"))
    in_eights = bits.take(1) == 1
    height = _side(bits, in_eights)
    ratio = bits.take(3)
    width = int(height * _WIDTH_OVER_HEIGHT[ratio - 1]) if ratio else _side(bits, in_eights)
    return height, width


class _Bits:
    def __init__(self, number: int) -> None:
        self._number = number

    def take(self, count: int) -> int:
        taken = self._number & ((1 << count) - 1)
        self._number >>= count
        return taken


def _side(bits: _Bits, in_eights: bool) -> int:
    return 8 * (bits.take(5) + 1) if in_eights else bits.take(_SIDE_BITS[bits.take(2)]) + 1


def _codestream(data: bytes) -> bytes:
    """Start of the image's data: the first box ``jxlc``, or ``jxlp`` after its number. Raises GeneratorError."""
    place = 0
    while place + 8 <= len(data):
        length, kind, header = int.from_bytes(data[place : place + 4], "big"), data[place + 4 : place + 8], 8
        if length == 1:
            length, header = int.from_bytes(data[place + 8 : place + 16], "big"), 16
        if kind in (b"jxlc", b"jxlp"):
            start = place + header + (4 if kind == b"jxlp" else 0)
            return data[start : start + 2 + _HEADER_BYTES]
        if length < header:  # 0: to the end of the file
            break
        place += length
    raise GeneratorError("not a JPEG XL image (a container without one)")
