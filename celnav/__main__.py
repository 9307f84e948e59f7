"""The command ``celnav``, also as ``python -m celnav``."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from celnav.command.answer import json_of, printable, text_of
from celnav.command.arguments import parser
from celnav.command.checks.input_files import check_input_files
from celnav.command.solving import answer
from celnav.errors import CelnavError

EXIT_FIX, EXIT_REFUSAL, EXIT_BAD_INPUT = 0, 1, 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return the exit status."""
    started_s = _process_started_s() if argv is None else time.perf_counter()
    arguments = parser().parse_args(argv)
    status = EXIT_FIX
    try:
        check_input_files(arguments)
        if arguments.command == "calibrate":
            from celnav.command.calibrating import calibrate_files

            text = calibrate_files(arguments)
        else:
            found = answer(arguments, started_s)
            text = (json_of if arguments.json else text_of)(found, arguments.matches)
            status = EXIT_FIX if found.fix.ok else EXIT_REFUSAL
    except CelnavError as error:
        print(printable(f"celnav: {error}"), file=sys.stderr)
        return EXIT_BAD_INPUT
    try:
        print(printable(text), flush=True)
    except BrokenPipeError:
        # The reader closed the pipe. Buffered output must not be written again when the interpreter exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return status


def _process_started_s() -> float:
    """Return the value of `time.perf_counter` when this process began, to 10 ms; its present value if that is unknown."""
    now_s = time.perf_counter()
    try:
        after_the_name = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        age_s = time.clock_gettime(time.CLOCK_BOOTTIME) - int(after_the_name[19]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return now_s
    return now_s - max(age_s, 0.0)


if __name__ == "__main__":
    sys.exit(main())
