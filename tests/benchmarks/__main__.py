"""Benchmarks of the service and of long takes, for developers: ``python -P -m tests.benchmarks NAME``."""

import typer

from tests.benchmarks.cancel import cancel
from tests.benchmarks.export import export
from tests.benchmarks.identity import identity
from tests.benchmarks.length import length
from tests.benchmarks.load import load
from tests.benchmarks.queue import queue

app = typer.Typer(no_args_is_help=True)
for command in (cancel, export, identity, length, load, queue):
    app.command()(command)

if __name__ == "__main__":
    app()
