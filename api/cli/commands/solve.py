"""`multicap solve`: 3D points that another system has located, to skeletons and all files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.reconstruct import print_summary
from api.cli.console import JsonOption, StageBars, emit, reporting, show_session, shows_help
from api.cli.options import UnitsOption, checked, known_units, known_up, with_choices
from pipeline.core.options.rules import config_problems, require

if not shows_help():
    from pipeline.capture.points import open_points, read_names
    from pipeline.export.character.source import CharacterSource
    from pipeline.run.engine.local import reconstruct_to_files


@with_choices(
    *("frame_range", "smoothing", "cutoff_hz", "feet", "exports", "preset", "output_rate_hz", "timeline", "body"),
    *("report", "segments", "sex", "mass_kg"),
)
def command(
    *,
    files: Annotated[
        list[Path], typer.Argument(help="TRC, C3D, BVH, CSV, NetCDF, NPY or 3D JSON, of people at one time.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results; made if it is missing.")],
    frame_rate: Annotated[
        float | None, typer.Option(help="Frames a second, for files that do not state them.", show_default=False)
    ] = None,
    units: UnitsOption = None,
    up: Annotated[
        str | None, typer.Option(metavar="x|-x|y|-y|z|-z", help="Axis that points up; people who stand tell it.")
    ] = None,
    names: Annotated[
        Path | None, typer.Option(help="JSON object: our joint, such as left_knee, by the name of your point.")
    ] = None,
    static: Annotated[
        Path | None, typer.Option(help="Static trial with more markers, which tell joints that FILES lack.")
    ] = None,
    character: Annotated[Path | None, typer.Option(help="Character that moves as each person.")] = None,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """Solve skeletons of people whose 3D points another system has located, such as a marker system."""
    paths: list[Path] = []
    with reporting(as_json, lambda: f"{len(paths)} files were written."), StageBars(visible=not as_json) as bars:
        config = checked(chosen)
        axis = None if up is None else known_up(up)
        table = None if names is None else read_names(names)
        session = open_points(files, frame_rate, known_units(units), axis, table, static)
        if not as_json:
            show_session(session.findings, None)
        require(config_problems(config, session.timebase.num_frames, session.timebase.frame_rate_hz))
        moved = None if character is None else CharacterSource(character)
        written = reconstruct_to_files(
            session, out, config, bars.update, sources=files, on_file=paths.append, character=moved
        )
    if as_json:
        findings = [finding.to_json() for finding in session.findings]
        emit({"metrics": written.metrics, "files": [str(path) for path in written.paths], "warnings": findings})
        return
    print_summary(written.metrics)
    for path in written.paths:
        typer.echo(f"  {path}")
