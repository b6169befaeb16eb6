"""`multicap opensim`: install the generic model of OpenSim."""

import typer

from api.cli.console import JsonOption, console, emit, reporting, shows_help
from pipeline.core.options.file_formats import installed_formats

if not shows_help():
    from pipeline.export.opensim import installed

app = typer.Typer(help="The generic model of OpenSim.", no_args_is_help=True)


@app.command()
def install(as_json: JsonOption = False) -> None:
    """Download the generic model that is scaled to people, and check it."""
    with reporting(as_json):
        path = installed.install()
    if as_json:
        emit({"path": str(path), "licence": installed.LICENCE})
        return
    console.print(f"The generic model is in {path}")
    console.print(installed.ATTRIBUTION)
    if "osim" not in installed_formats():
        console.print("Exports for OpenSim need its package too: pip install 'multicap\\[opensim]'")
