"""Start of the command line: Ctrl-C ends it with a message, even while modules are imported."""

from api.cli.interruption import end_interrupted


def main() -> None:
    """Import the command line and run it."""
    try:
        from api.cli.main import main as run  # noqa: PLC0415 - the import may be interrupted
    except KeyboardInterrupt:
        end_interrupted()
    run()


if __name__ == "__main__":
    main()
