"""A program under test that counts, within a sequence, the frames that it has been given; it may crash at the second."""

import json
import os
import sys

WAY = sys.argv[1]


def main():
    sequence, seen = None, 0
    for line in sys.stdin:
        request = json.loads(line)
        if request["type"] == "hello":
            print(
                json.dumps({"type": "hello", "protocol": "skybench-solver/1", "name": WAY, "version": "1"}), flush=True
            )
            continue
        place = request.get("sequence")
        index = -1 if place is None else place["index"]
        if place is not None:
            seen = seen + 1 if place["id"] == sequence else 1
            sequence = place["id"]
        if WAY == "crash" and index == 1 and seen == 2:
            os._exit(7)
        images = len(os.listdir(os.path.dirname(request["image"])))
        answer = {"type": "fix", "frame_id": request["frame_id"], "status": "fix", "lat_deg": 48.0, "lon_deg": 11.0}
        print(json.dumps(answer | {"time_ms": {"index": index, "seen": seen, "images": images}}), flush=True)


if __name__ == "__main__":
    main()
