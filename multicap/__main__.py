"""``python -m multicap``, and the command ``multicap``: the command line."""

from api.cli.start import main

if __name__ == "__main__":
    main()
