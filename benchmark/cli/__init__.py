"""The command `skybench`."""


def main() -> None:
    """Run the command, importing its many parts only now."""
    from benchmark.cli.app import main as run

    run()
