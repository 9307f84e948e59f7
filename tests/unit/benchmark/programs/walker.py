"""A program under test that answers with all that it can read from its image's folder, its own and all above them."""

import json
import os
import sys
from pathlib import Path

WORDS = (b"latitude_deg", b"site", b"skybench-stars", b"scenario")
MOST_FILES = 3000
PUBLIC = ("benchmark", "generator", "celnav")
"""Packages that a program of skybench's own interpreter is shown: they hold the scenarios of tasks, which anyone can read."""


def readable(start):
    """Files below a folder and below every folder above it, to three levels."""
    for folder in (start, *start.parents):
        for place, folders, files in os.walk(folder):
            if len(Path(place).relative_to(folder).parts) >= 3 or place in ("/proc", "/sys", "/usr"):
                folders.clear()
            folders[:] = [name for name in folders if name not in PUBLIC]
            yield from (Path(place, name) for name in files)


def telling(path):
    """Whether a file holds words of a truth; a table of stars is known by its schema's format."""
    try:
        with path.open("rb") as stream:
            content = stream.read(2_000_000)
    except OSError:
        return False
    return path.suffix in (".json", ".parquet", ".yaml") and any(word in content for word in WORDS)


for line in sys.stdin:
    asked = json.loads(line)
    if asked["type"] == "hello":
        answer = {"type": "hello", "protocol": "skybench-solver/1", "name": "walker", "version": "1"}
    else:
        image = Path(asked["image"])
        beside = sorted(path.name for path in image.parent.iterdir())
        found = set()
        for number, path in enumerate(readable(image.parent)):
            if number > MOST_FILES:
                break
            if telling(path):
                found.add(path.name)
        reason = json.dumps({"beside": len(beside), "telling": [name[:20] for name in sorted(found)[:3]]})
        answer = {"type": "fix", "frame_id": asked["frame_id"], "status": "refused", "reason": reason}
    print(json.dumps(answer), flush=True)
