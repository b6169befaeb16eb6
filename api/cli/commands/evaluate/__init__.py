"""`multicap evaluate`: accuracy of reconstructions against a known truth."""

import typer

from api.cli.commands.evaluate import actors, human36m, mvor, panoptic, rendered, shelf, simulated

app = typer.Typer(help="Accuracy against a known truth.", no_args_is_help=True)


app.command("rendered")(rendered.command)
app.command("shelf")(shelf.command)
app.command("campus")(actors.command)
app.command("mvor")(mvor.command)
app.command("panoptic")(panoptic.command)
app.command("human36m")(human36m.command)
app.command("simulated")(simulated.command)
