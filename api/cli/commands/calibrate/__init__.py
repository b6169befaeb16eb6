"""`multicap calibrate`: make a calibration from a board or from people."""

import typer

from api.cli.commands.calibrate import board, people

app = typer.Typer(help="Calibrations: make one from a board or from people.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Make a calibration."""


app.command("board")(board.command)
app.command("people")(people.command)
