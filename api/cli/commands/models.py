"""`multicap models`: list, install, add and verify detector networks."""

import math
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, cast

import typer

from api.cli.console import JsonOption, console, emit, reporting, show_list, shows_help
from pipeline.core.errors import ModelError
from pipeline.core.layouts import LAYOUTS
from pipeline.core.options.config import NETWORKS_OF_PROFILES
from pipeline.detection.own_network import HEADS, Channels, usual_network

if not shows_help():
    from pipeline.detection import models
    from pipeline.detection.own.files import add_own

app = typer.Typer(help="Detector networks: list, install, add from a file, verify.", no_args_is_help=True)


@app.command("list")
def list_(as_json: JsonOption = False) -> None:
    """List the networks that Multicap supports."""
    with reporting(as_json):
        known = models.status()
    cells: dict[str, Callable[[models.ModelStatus], str]] = {
        "name": lambda model: model.name,
        "installed": lambda model: "yes" if model.installed else "no",
        "licence": lambda model: model.licence,
        "sha256": lambda model: model.sha256,
    }
    show_list("models", known, [field.name for field in fields(models.ModelStatus)], cells, as_json)


@app.command()
def install(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Names of networks, from `multicap models list`. Default: all networks of the profiles."),
    ] = None,
) -> None:
    """Download the packages of networks, convert the networks and check them."""
    with reporting(as_json=False):
        for name in names or NETWORKS_OF_PROFILES:
            path = models.install(name)
            console.print(f"{name}: installed, {path.stat().st_size / 1e6:.1f} MB")


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="Name of a network from `multicap models list`, or your own ONNX file.")],
    source: Annotated[
        str | None, typer.Option("--from", help="Folder, file or URL of the named network, from you.")
    ] = None,
    head: Annotated[str | None, typer.Option(help="Outputs of your own ONNX file.", metavar="|".join(HEADS))] = None,
    joints: Annotated[
        str | None, typer.Option(help="Keypoints of your own ONNX file.", metavar="|".join(LAYOUTS))
    ] = None,
    input_size: Annotated[
        str | None, typer.Option(help="Size of its input. Default: the file's.", metavar="WIDTHxHEIGHT")
    ] = None,
    channels: Annotated[
        str | None, typer.Option(help="Order of its colours. Default: the head's.", metavar="rgb|bgr")
    ] = None,
    mean: Annotated[str | None, typer.Option(help="Mean of its colours. Default: the head's.", metavar="A,B,C")] = None,
    std: Annotated[
        str | None, typer.Option(help="Standard deviation of its colours. Default: the head's.", metavar="A,B,C")
    ] = None,
) -> None:
    """Install a network from your own folder, file or URL, or add a network of your own from an ONNX file."""
    with reporting(as_json=False):
        if head is None and joints is None:
            if source is None:
                raise ModelError("Give --from with the name of a network, or --head and --joints with an ONNX file.")
            path = models.add(name, source)
            console.print(f"{name}: installed, {path.stat().st_size / 1e6:.1f} MB")
            return
        if head not in HEADS or joints is None or joints not in LAYOUTS:
            raise ModelError(
                f"{Path(name).name} needs --head with one of {', '.join(HEADS)}, and --joints with one of "
                f"{', '.join(LAYOUTS)}."
            )
        network = usual_network(head, joints, None if input_size is None else _size(input_size))
        if channels is not None:
            network = replace(network, channels=_channels(channels))
        if mean is not None:
            network = replace(network, mean=_triple(mean, "mean"))
        if std is not None:
            network = replace(network, std=_triple(std, "std"))
        added = add_own(Path(name), network, has_chosen_size=input_size is not None)
    console.print(f"{Path(name).name}: added. Use it by --detector {added}")


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ModelError(f"--input-size is width and height, such as 192x256, not {text!r}.")
    return int(width), int(height)


def _channels(text: str) -> Channels:
    if text not in {"rgb", "bgr"}:
        raise ModelError(f"--channels is rgb or bgr, not {text!r}.")
    return cast(Channels, text)


def _triple(text: str, name: str) -> tuple[float, float, float]:
    try:
        first, second, third = (float(part) for part in text.split(","))
    except ValueError:
        raise ModelError(f"--{name} is three numbers, such as 1,2,3, not {text!r}.") from None
    if not all(map(math.isfinite, (first, second, third))) or (name == "std" and 0 in {first, second, third}):
        raise ModelError(f"--{name} is three finite numbers, of --std none of them 0, not {text!r}.")
    return first, second, third


@app.command()
def verify(as_json: JsonOption = False) -> None:
    """Compare the checksums of all installed networks."""
    with reporting(as_json):
        installed = [model.name for model in models.status() if model.installed]
        for name in installed:
            models.verify(name)
            console.print(f"{name}: the checksum is right")
    if as_json:
        emit({"verified": installed})
