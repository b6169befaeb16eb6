"""`multicap samples`: install the sample capture."""

import typer

from api.cli.console import JsonOption, console, emit, reporting, shows_help

if not shows_help():
    from pipeline.core.runtime.packages import samples

app = typer.Typer(help="A real four-camera capture of two people.", no_args_is_help=True)


@app.command()
def install(as_json: JsonOption = False) -> None:
    """Download the sample capture and check it."""
    with reporting(as_json):
        sample = samples.install()
    if as_json:
        emit(
            {
                "path": str(sample.path),
                "videos": {camera: str(path) for camera, path in sample.videos.items()},
                "calibration": str(sample.calibration),
            }
        )
        return
    console.print(f"{len(sample.videos)} videos and a calibration in {sample.path}")
    console.print(sample.attribution)
