"""Command line ``multicap``: its commands, and the client of a service."""

import os

# Help and errors of usage in plain text: Rich's boxes take a third of the time of ``--help``.
os.environ.setdefault("TYPER_USE_RICH", "0")
