"""A program that tells how many bytes it could keep in files, and what becomes of an attempt to keep more."""

import json
import os
import sys

for line in sys.stdin:
    request, found = json.loads(line), {}
    if request["type"] == "hello":
        print(json.dumps({"type": "hello", "protocol": "skybench-solver/1"}), flush=True)
        continue
    for folder in request["folders"]:
        place = os.statvfs(folder)
        found[folder] = [place.f_blocks * place.f_frsize, place.f_files]
        with open(f"{folder}/hoard", "wb") as file:
            try:
                os.posix_fallocate(file.fileno(), 0, 2**30)
                found[folder].append("kept")
            except OSError as error:
                found[folder].append(os.strerror(error.errno))
    print(json.dumps(found), flush=True)
