"""A program under test whose refusals say what it finds in its own folder."""

import json
import sys
from pathlib import Path


def main():
    for line in sys.stdin:
        request = json.loads(line)
        if request["type"] == "hello":
            answer = {"type": "hello", "protocol": "skybench-solver/1", "name": "looking", "version": "1"}
        else:
            files = sorted(str(path) for path in Path().rglob("*") if path.is_file() and path.stat().st_size)
            answer = {"type": "fix", "frame_id": request["frame_id"], "status": "refused", "reason": " ".join(files)}
        print(json.dumps(answer), flush=True)


main()
