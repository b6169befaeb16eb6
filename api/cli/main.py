"""Entry point of the command line `multicap`: the list of commands, which are imported when they are used."""

import atexit
import gc
import importlib
import sys
import warnings
from collections.abc import Mapping
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command, get_group

from api.cli.interruption import end_interrupted
from pipeline.core.runtime.plugins import PluginWarning
from pipeline.core.runtime.resources import collect_seldom, keep_freed_memory

# Names of the commands' modules with their sentences in the help: `multicap --help` imports no module.
COMMANDS: Mapping[str, str] = {
    "demo": "Reconstruct the sample capture with a temporary service: BVH, JSON, metrics and pictures.",
    "serve": "Run the service on this machine: web API, workers, broker and database.",
    "check": "Check a capture before its reconstruction: files, calibration, people at some instants.",
    "reconstruct": "Reconstruct videos or keypoints of calibrated cameras, without a service.",
    "solve": "Solve skeletons of people in 3D from another system: TRC, C3D, BVH, CSV, NetCDF, NPY, JSON.",
    "live": "Capture people live from cameras, streams or files, until Ctrl-C or the end of the files.",
    "batch": "Reconstruct many takes of one rig, and go on after an interruption.",
    "calibrate": "Make a calibration from a board, from people, or from known points.",
    "calibration": "Calibration files of any supported format: show, check, convert; plan of a rig.",
    "sync": "Measure when each camera started, from the people in view.",
    "models": "Detector networks: list, install, add from a file, verify.",
    "samples": "Sample capture of two people with four cameras: install.",
    "bodies": "Human body of exports, and body models of your own.",
    "opensim": "Generic model of OpenSim for exports: install.",
    "keys": "API keys of the service: create, list, revoke.",
    "webhooks": "Webhooks of the service: secrets and undelivered messages.",
    "audit": "Audit trail: creations, changes and deletions in the service.",
    "doctor": "Look for what is wrong with a service: database, disk, files that belong to nothing.",
    "backup": "Backups of the service: create, restore, verify.",
    "simulate": "Write a simulated scene: keypoints, timestamps, calibration and the truth.",
    "help": "Pages of the documentation: list the topics, show one.",
    "evaluate": "Accuracy against a known truth.",
    "benchmark": "Speed and memory.",
}


class LazyGroup(TyperGroup):
    """Group of the commands in ``COMMANDS``; a command's module is imported when the command is used."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for name, sentence in COMMANDS.items():
            self.add_command(TyperCommand(name, callback=None, short_help=sentence))

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Find the command by the first word and import it."""
        name, _, rest = super().resolve_command(ctx, args)
        try:
            return name, None if name is None else load(name), rest
        except KeyboardInterrupt:
            end_interrupted()


def load(name: str) -> Any:
    """Import a command of ``COMMANDS``: a module's group ``app``, or its function ``command``.

    A format of another package that can't be loaded ends a command; the service continues without it.
    """
    warnings.simplefilter("default" if name == "serve" else "error", PluginWarning)
    module = importlib.import_module(f"{__package__}.commands.{name}")
    if hasattr(module, "app"):
        command: Any = get_group(module.app)
        for each in command.commands.values():
            each.short_help = each.help.partition("\n\n")[0]  # whole, where Typer would cut it
    else:
        alone = typer.Typer(add_completion=False)
        alone.command()(module.command)
        command = get_command(alone)
    command.name = name
    return command


app = typer.Typer(name="multicap", cls=LazyGroup, no_args_is_help=True)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # noqa: PLC0415 - slow to import, and seldom needed

        typer.echo(f"multicap {version('multicap')}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Markerless motion capture of several people from calibrated cameras."""


def main() -> None:
    """Run the command line."""
    collect_seldom()
    keep_freed_memory()
    # Skip the collection of garbage at exit: among all loaded libraries it takes two seconds.
    atexit.register(gc.freeze)
    try:
        app()
    except PluginWarning as error:
        sys.exit(str(error))
    except ValueError as error:
        _refuse_settings(error)
        raise


def _refuse_settings(error: ValueError) -> None:
    """Exit with a sentence for each wrong setting if the error is about the service's settings."""
    from pydantic import ValidationError  # noqa: PLC0415 - only after an error, so that the help answers at once
    from pydantic_settings import SettingsError  # noqa: PLC0415

    from api.cli.console import EXIT_BAD_INPUT, refusal  # noqa: PLC0415
    from api.web.settings import Settings  # noqa: PLC0415
    from worker.run.settings import explain  # noqa: PLC0415

    if isinstance(error, SettingsError) or (isinstance(error, ValidationError) and error.title == Settings.__name__):
        for sentence in explain(Settings, error):
            refusal(sentence)
        sys.exit(EXIT_BAD_INPUT)


if __name__ == "__main__":
    main()
