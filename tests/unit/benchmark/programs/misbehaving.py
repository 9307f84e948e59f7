"""A program under test that does what its first argument says; by itself it answers every frame with one position."""

import json
import mmap
import os
import subprocess
import sys
import time

WAY = sys.argv[1]
ANSWER = {"type": "fix", "status": "fix", "lat_deg": 48.0, "lon_deg": 11.0}


def main():
    asked = 0
    if WAY == "no hello":
        time.sleep(100)
    if WAY == "wrong hello":
        print(json.dumps({"type": "hello", "protocol": "skybench-solver/0"}), flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        if request["type"] == "hello":
            print(
                json.dumps({"type": "hello", "protocol": "skybench-solver/1", "name": WAY, "version": "1"}), flush=True
            )
            continue
        asked += 1
        if WAY == "hang":
            time.sleep(100)
        elif WAY == "hang with a child":
            nap = [sys.executable, "-c", "import time; time.sleep(100)"]
            child = subprocess.Popen(nap, start_new_session=True)
            with open(os.environ["SOLVER_CHILD_PID_FILE"], "w") as file:
                file.write(str(child.pid))
            time.sleep(100)
        elif WAY == "crash":
            print("cannot go on: the stars are wrong", file=sys.stderr, flush=True)
            os._exit(7)
        elif WAY == "abort":
            os.abort()
        elif WAY == "garbage":
            print("Solved! lat = 48", flush=True)
        elif WAY == "list":
            print("[1, 2]", flush=True)
        elif WAY == "deep":
            print("[" * 200_000, flush=True)
        elif WAY == "flood":
            while True:
                print("x" * 10_000, end="", flush=True)
        elif WAY == "flood of lines":
            print("x\n" * 100_000, flush=True)
        elif WAY == "flood of errors":
            print("e" * 1_000_000, file=sys.stderr, flush=True)
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"]}), flush=True)
        elif WAY == "memory":
            kept = []
            while True:
                kept.append(bytearray(10_000_000))
        elif WAY == "memory of children":
            hold = "kept = bytearray(250_000_000); import time; time.sleep(100)"
            children = [subprocess.Popen([sys.executable, "-c", hold]) for _ in range(3)]
            children[0].wait()
        elif WAY == "files in memory":
            for name in ("one", "two"):
                place = os.memfd_create(name)
                for _ in range(400):
                    os.write(place, bytes(1_000_000))
            time.sleep(100)
        elif WAY == "mapped file in memory":
            place = os.memfd_create("one")
            os.truncate(place, 400_000_000)
            kept = mmap.mmap(place, 400_000_000)
            for start in range(0, len(kept), 1_000_000):
                kept[start : start + 1_000_000] = bytes(1_000_000)
            time.sleep(1.5)
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"]}), flush=True)
        elif WAY == "many processes":
            for _ in range(100):
                if not os.fork():
                    time.sleep(100)
            time.sleep(100)
        elif WAY == "shared memory":
            kept = bytearray(300_000_000)
            children = []
            for _ in range(3):
                if child := os.fork():
                    children.append(child)
                else:
                    time.sleep(1.5)
                    os._exit(0)
            for child in children:
                os.waitpid(child, 0)
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"], "lat_deg": len(kept) / 1e7}), flush=True)
        elif WAY == "spy":
            beside = os.listdir(os.path.dirname(request["image"]))
            answer = {"type": "fix", "status": "refused", "reason": " ".join(["saw", *beside])}
            print(json.dumps(answer | {"frame_id": request["frame_id"]}), flush=True)
        elif WAY == "other frame":
            print(json.dumps(ANSWER | {"frame_id": "another"}), flush=True)
        elif WAY == "chatter":
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"]}) + "\nand more", flush=True)
        elif WAY == "late":
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"]}), flush=True)
            if request["frame_id"] == "frame-00000" and asked > 1:
                time.sleep(0.2)
                print("{}", flush=True)
        elif WAY == "later":
            if request["frame_id"] == "frame-00001":
                print("{}", flush=True)
                time.sleep(0.2)
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"]}), flush=True)
        elif WAY == "loud":
            print(f"I am looking at {request['frame_id']}", file=sys.stderr, flush=True)
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"]}), flush=True)
        elif WAY == "count":
            time.sleep(0.02)
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"], "lat_deg": float(asked)}), flush=True)
        else:
            print(json.dumps(ANSWER | {"frame_id": request["frame_id"]}), flush=True)


main()
