"""`multicap`, the command line."""

import typer

from api.commands import audit, benchmark, demo, evaluate, keys, models, reconstruct, samples, serve, simulate, webhooks
from pipeline.memory import keep_freed_memory

app = typer.Typer(
    name="multicap",
    help="Markerless motion capture of several people from calibrated cameras.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
)
app.command("audit")(audit.command)
app.command("demo")(demo.command)
app.command("reconstruct")(reconstruct.command)
app.command("serve")(serve.command)
app.command("simulate")(simulate.command)
app.add_typer(evaluate.app, name="evaluate")
app.add_typer(benchmark.app, name="benchmark")
app.add_typer(keys.app, name="keys")
app.add_typer(models.app, name="models")
app.add_typer(samples.app, name="samples")
app.add_typer(webhooks.app, name="webhooks")


def main() -> None:
    """Run the command line."""
    keep_freed_memory()
    app()


if __name__ == "__main__":
    main()
