"""Number of scans of a JPEG, counted without decoding it: each costs a pass over all pixels, however few bytes it has."""

from __future__ import annotations

import re

MOST_SCANS = 100
"""Progressive pictures have some ten scans; even one scan per bit of a coefficient gives fewer than a hundred."""
_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]")
"""In the data of a scan, 0xFF is followed by zero or a restart code; otherwise it starts a marker (ITU-T T.81, B.1.1)."""
_START_OF_IMAGE, _START_OF_SCAN, _END_OF_IMAGE = b"\xff\xd8", 0xDA, 0xD9


def too_many_scans(data: bytes) -> bool:
    """Whether a file is a JPEG whose first picture has more than MOST_SCANS scans; a damaged one counts as far as it goes."""
    if not data.startswith(_START_OF_IMAGE):
        return False
    place = len(_START_OF_IMAGE)
    for _ in range(MOST_SCANS + 1):
        while (marker := _MARKER.search(data, place)) and data[marker.end() - 1] != _START_OF_SCAN:
            if data[marker.end() - 1] == _END_OF_IMAGE:
                return False
            # Segments, a preview's picture among them, are skipped by their stated lengths.
            place = marker.end() + max(2, int.from_bytes(data[marker.end() : marker.end() + 2], "big"))
        if marker is None:
            return False
        place = marker.end()
    return True
