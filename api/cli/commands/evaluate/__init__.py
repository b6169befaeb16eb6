"""`multicap evaluate`: accuracy of reconstructions against a known truth."""

import typer

from api.cli.commands.evaluate import joint_centers, mvor, panoptic, rendered, shelf, simulated

app = typer.Typer(help="Accuracy against a known truth.", no_args_is_help=True)


app.command("rendered")(rendered.command)
app.command("joint-centers")(joint_centers.command)
app.command("shelf")(shelf.command)
app.command("mvor")(mvor.command)
app.command("panoptic")(panoptic.command)
app.command("simulated")(simulated.command)
