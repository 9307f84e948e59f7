"""A program under test that answers with what it can reach of what its first request names."""

import json
import os
import socket
import sys
from pathlib import Path


def tried(attempt):
    try:
        return str(attempt())[:200]
    except Exception as error:
        return type(error).__name__


def environment_of_parents():
    """Environment of any other process that can be seen."""
    pids = [name for name in os.listdir("/proc") if name.isdigit() and int(name) != os.getpid()]
    found = b"".join(Path("/proc", pid, "environ").read_bytes() for pid in pids)
    return "SPY_SECRET" if b"SPY_SECRET" in found else "nothing"


def connected(port):
    with socket.create_connection(("127.0.0.1", port), timeout=5):
        return "connected"


def written(path):
    Path(path).write_text("mine")
    return "written"


def killed(pid):
    os.kill(pid, 0)
    return "reached"


def attempts_of(request):
    return {
        "truth": lambda: Path(request["truth"]).read_text(),
        "above": lambda: sorted(os.listdir("..")),
        "home": lambda: sorted(os.listdir(request["home"])),
        "environment": environment_of_parents,
        "network": lambda: connected(request["port"]),
        "own folder": lambda: written("note.txt"),
        "system": lambda: written(sys.prefix + "/spy.txt"),
        "caller": lambda: killed(request["caller"]),
        "temporary": lambda: written("/tmp/spy.txt"),
        "image": lambda: Path(request["image"]).read_text(),
        "mount": lambda: os.system("mount -o remount,rw /usr 2>/dev/null") == 0,
    }


for line in sys.stdin:
    asked = json.loads(line)
    if asked["type"] == "hello":
        answer = {"type": "hello", "protocol": "skybench-solver/1", "name": "spy", "version": "1"}
    else:
        answer = {name: tried(attempt) for name, attempt in attempts_of(asked).items() if name in asked["attempts"]}
    print(json.dumps(answer), flush=True)
