"""The command `skybench`."""

import os

from benchmark.cli import interrupt
from generator.instruction_set import settle


def main() -> None:
    """Run the command. Its parts are only imported here, so that Ctrl-C ends the import as quietly as the work."""
    interrupt.listen()
    settle()
    # Arrow's own allocator reserves 1 GiB of address space with its first table, which a limit (`ulimit -v`) may not allow.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    try:
        from benchmark.cli.app import main as run

        run()
    except BaseException as error:
        if not interrupt.interrupted(error):
            raise
        interrupt.say_so()
        raise SystemExit(interrupt.exit_status()) from None
