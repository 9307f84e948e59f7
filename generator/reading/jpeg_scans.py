"""Number of scans in a JPEG, counted from its markers before it is decoded.

Each scan costs a pass over all pixels, however few bytes it has, and decoders set no limit. The structure is that of ITU-T
T.81, B.1.1 and B.2, as libjpeg follows it, so that no scan that would be decoded is missed.
"""

from __future__ import annotations

import re

SIGNATURE = b"\xff\xd8\xff"
MOST_SCANS = 100
"""Limit of the number of scans. Progressive pictures have some ten; even one scan per coefficient bit gives fewer than a
hundred."""
MOST_SEGMENTS = 20_000
"""Limit of the number of segments, each of which costs time too; colour profiles and previews take some hundred."""
# Markers without a length are passed over, as is 0xFF in front of zero, which stands for itself in the data of a scan. In a
# run of 0xFF only the last one starts a marker, so the search takes one step per byte.
_MARKER = re.compile(rb"\xff[\xc0-\xcf\xd9-\xef\xfe]")
_END_OF_IMAGE, _START_OF_SCAN = 0xD9, 0xDA


def excess(data: bytes) -> str | None:
    """What a JPEG has too many of, with the limit: a phrase for messages.

    None if it is within the limits, and for data that are not a JPEG. A picture with more pictures behind it (MPO) is a JPEG;
    only its first one counts.
    """
    if not data.startswith(SIGNATURE):
        return None
    scans, place = 0, 2
    for _ in range(MOST_SEGMENTS):
        marker = _MARKER.search(data, place)
        if marker is None or data[marker.end() - 1] == _END_OF_IMAGE:
            return None
        place = marker.end()
        if data[place - 1] == _START_OF_SCAN:
            # The few bytes of a scan's header contain no marker, so its stated length need not be trusted.
            scans += 1
            if scans > MOST_SCANS:
                return f"more than {MOST_SCANS} scans"
        else:
            place += max(2, int.from_bytes(data[place : place + 2], "big"))
    return f"more than {MOST_SEGMENTS} segments"
