"""Benchmarks of the service, of long takes and of methods, for developers: ``python -P -m tests.benchmarks NAME``."""

import typer

from tests.benchmarks.cancel import cancel
from tests.benchmarks.export import export
from tests.benchmarks.forces import forces
from tests.benchmarks.identity import identity
from tests.benchmarks.joint_centers import joint_centers
from tests.benchmarks.length import length
from tests.benchmarks.live_people import live_people
from tests.benchmarks.load import load
from tests.benchmarks.queue import queue
from tests.benchmarks.service import service

app = typer.Typer(no_args_is_help=True)
for command in (cancel, export, forces, identity, joint_centers, length, live_people, load, queue, service):
    app.command()(command)

if __name__ == "__main__":
    app()
