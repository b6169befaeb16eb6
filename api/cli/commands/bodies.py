"""`multicap bodies`: install the human body of exports."""

import typer

from api.cli.console import JsonOption, console, emit, reporting
from pipeline.motion.body import installed

app = typer.Typer(help="The human body of exports.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """The human body of exports."""


@app.command()
def install(as_json: JsonOption = False) -> None:
    """Download the human body and check it."""
    with reporting(as_json):
        path = installed.install()
    if as_json:
        emit({"path": str(path), "licence": installed.LICENCE})
        return
    console.print(f"The human body is in {path}")
    console.print(installed.ATTRIBUTION)
