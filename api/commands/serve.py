"""`multicap serve`: the whole service on this machine, as one tree of processes."""

import os
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Annotated

import httpx2
import typer
from rich.text import Text

from api.console import EXIT_BAD_INPUT, console, reporting
from api.settings import Settings
from pipeline.detect import models
from worker import embedded
from worker.jobs.spec import JobSpec
from worker.jobs.store import JobStore
from worker.supervisor import Program, Supervisor

# What it prints, before its address, as soon as it can be used.
READY = "Multicap is ready at "

_HOST = "127.0.0.1"


def _listen(port: int) -> socket.socket:
    """A socket that listens; it is kept here, so a restart of the API neither loses the port nor refuses a client."""
    try:
        return socket.create_server((_HOST, port), backlog=512)
    except OSError as error:
        raise _refusal(f"Port {port} can't be had: {error.strerror}. Choose another one with --port.") from error


def _refusal(sentence: str) -> typer.Exit:
    console.print(Text.assemble(("error ", "bold red"), sentence), soft_wrap=True)
    return typer.Exit(EXIT_BAD_INPUT)


def _api(place: embedded.Place, listening: socket.socket) -> Program:
    fd = listening.fileno()
    command = [sys.executable, "-P", "-m", "api", "--fd", str(fd)]
    return Program("api", command, place.environment(), pass_fds=[fd])


def _announce(url: str) -> None:
    """Print the address as soon as all parts answer."""
    with httpx2.Client(base_url=url, timeout=5.0, trust_env=False) as client:
        while True:
            try:
                if client.get("/readyz").is_success:
                    break
            except httpx2.TransportError:
                pass
            time.sleep(0.1)
    typer.echo(f"{READY}{url}")
    console.print("Ctrl-C stops it.")


def command(
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0 for a free one.")] = 8000,
    data: Annotated[Path | None, typer.Option(help="Folder of everything it keeps; made if it is missing.")] = None,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Chunks worked on at once.")] = os.cpu_count() or 1,
) -> None:
    """Run the service on this machine: web API, workers, broker and database, until Ctrl-C."""
    settings = Settings() if data is None else Settings(data_dir=data)
    with reporting(as_json=False):
        models.verify(JobSpec().detector)
    try:
        with embedded.occupy(settings.data_dir) as place, _listen(port) as listening:
            JobStore(settings.resolved_database_url).migrate()
            url = f"http://{_HOST}:{listening.getsockname()[1]}"
            threading.Thread(target=_announce, args=[url], daemon=True).start()
            programs = [
                embedded.broker(place),
                embedded.worker(place, workers),
                embedded.reaper(place),
                _api(place, listening),
            ]
            Supervisor(programs, place.logs_dir, _warn).run()
    except embedded.DataFolderError as error:
        raise _refusal(str(error)) from error
    console.print("Stopped.")


def _warn(sentence: str) -> None:
    console.print(Text.assemble(("warning ", "yellow"), sentence), soft_wrap=True)
