"""`multicap calibrate`: make a calibration from a board."""

import typer

from api.cli.commands.calibrate import board

app = typer.Typer(help="Calibrations: make one from a board.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Make a calibration."""


app.command("board")(board.command)
