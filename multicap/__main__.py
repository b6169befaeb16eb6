"""``python -m multicap``: the command line, like the command ``multicap``."""

from api.cli.start import main

if __name__ == "__main__":
    main()
