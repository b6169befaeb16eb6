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

from api.app import ExposedError, refuse_strangers
from api.commands.store import opened_store
from api.console import console, refusal, reporting
from api.settings import Settings
from pipeline.detect import models
from worker import embedded
from worker.jobs.spec import JobSpec
from worker.supervisor import Program, Supervisor

# What it prints, before its address, as soon as it can be used.
READY = "Multicap is ready at "

# Who listens everywhere is reached here.
_LOOPBACK_OF = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - a table of names


def _listen(host: str, port: int) -> socket.socket:
    """A socket that listens; it is kept here, so a restart of the API neither loses the port nor refuses a client."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=512)
    except OSError as error:
        sentence = f"Port {port} can't be had on {host}: {error.strerror}. Choose another one with --port."
        raise refusal(sentence) from error


def _url(host: str, port: int) -> str:
    """Where this machine reaches the service."""
    name = _LOOPBACK_OF.get(host, host)
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


def _api(place: embedded.Place, host: str, listening: socket.socket) -> Program:
    fd = listening.fileno()
    command = [sys.executable, "-P", "-m", "api", "--fd", str(fd)]
    return Program("api", command, place.environment() | {"MULTICAP_HOST": host}, pass_fds=[fd])


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
    host: Annotated[str, typer.Option(help="Address to listen on; beyond this machine only with keys.")] = "127.0.0.1",
    data: Annotated[Path | None, typer.Option(help="Folder of everything it keeps; made if it is missing.")] = None,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Chunks worked on at once.")] = os.cpu_count() or 1,
) -> None:
    """Run the service on this machine: web API, workers, broker and database, until Ctrl-C."""
    settings = Settings(host=host) if data is None else Settings(host=host, data_dir=data)
    with reporting(as_json=False):
        models.verify(JobSpec().detector)
    try:
        with embedded.occupy(settings.data_dir) as place:
            with opened_store(settings) as store:
                refuse_strangers(settings, store)
            _serve(settings, place, port, workers)
    except (embedded.DataFolderError, ExposedError) as error:
        raise refusal(str(error)) from error
    console.print("Stopped.")


def _serve(settings: Settings, place: embedded.Place, port: int, workers: int) -> None:
    with _listen(settings.host, port) as listening:
        url = _url(settings.host, listening.getsockname()[1])
        threading.Thread(target=_announce, args=[url], daemon=True).start()
        programs = [
            embedded.broker(place),
            embedded.worker(place, workers),
            embedded.reaper(place),
            _api(place, settings.host, listening),
        ]
        Supervisor(programs, place.logs_dir, _warn).run()


def _warn(sentence: str) -> None:
    console.print(Text.assemble(("warning ", "yellow"), sentence), soft_wrap=True)
