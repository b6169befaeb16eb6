"""`multicap`, the command line."""

import atexit
import gc
import sys

import typer
from pydantic import ValidationError
from pydantic_settings import SettingsError

from api.commands import (
    audit,
    backup,
    benchmark,
    demo,
    evaluate,
    keys,
    models,
    reconstruct,
    samples,
    serve,
    simulate,
    webhooks,
)
from api.console import EXIT_BAD_INPUT, refusal
from api.settings import Settings
from pipeline.memory import keep_freed_memory
from worker.settings import explain

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
app.add_typer(backup.app, name="backup")
app.add_typer(benchmark.app, name="benchmark")
app.add_typer(keys.app, name="keys")
app.add_typer(models.app, name="models")
app.add_typer(samples.app, name="samples")
app.add_typer(webhooks.app, name="webhooks")


def main() -> None:
    """Run the command line."""
    keep_freed_memory()
    # At its exit Python looks for garbage in all that the libraries have loaded: two seconds of Ctrl-C's two.
    atexit.register(gc.freeze)
    try:
        app()
    except (ValidationError, SettingsError) as error:
        if isinstance(error, ValidationError) and error.title != Settings.__name__:
            raise
        for sentence in explain(Settings, error):
            refusal(sentence)
        sys.exit(EXIT_BAD_INPUT)


if __name__ == "__main__":
    main()
