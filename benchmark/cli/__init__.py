"""The command `skybench`."""

from benchmark.cli import interrupt


def main() -> None:
    """Run the command. Its parts are imported only now, so that Ctrl-C ends the import as quietly as the work."""
    interrupt.listen()
    try:
        from benchmark.cli.app import main as run

        run()
    except BaseException as error:
        if not interrupt.interrupted(error):
            raise
        interrupt.say_so()
        raise SystemExit(interrupt.exit_status()) from None
