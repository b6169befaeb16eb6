"""`multicap reconstruct`: videos, or 2D joints of another program, to people in motion; no service needed."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import typer
from pydantic import Field, TypeAdapter

from api.cli.console import JsonOption, StageBars, emit, print_table, reporting, show_session, shows_help, warn
from api.cli.options import ProviderOption, checked, known_up, take_provider, users_cache, with_choices
from api.cli.sources import SourceOptions, parameters, with_source
from pipeline.core.errors import InputError, Problem
from pipeline.core.findings import Finding
from pipeline.core.options.config import method_warnings
from pipeline.core.options.edits import MAX_EDITS, PeopleEdit
from pipeline.core.options.rules import config_problems, require
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import EDITS_UNREADABLE, NOTHING_BLURRED, PARAMETER_UNREADABLE
from pipeline.core.problems.session_codes import BONES_INVALID
from pipeline.run.engine.plan import STAGE_BY_NAME

if not shows_help():
    from api.cli.space import document, require_space, session_space
    from pipeline.capture.laboratory.laboratory_files import WantedClock, is_place, with_laboratory
    from pipeline.capture.session import Session
    from pipeline.export.character.character_files import DESCRIPTION
    from pipeline.export.character.mapping import read_bone_table
    from pipeline.export.character.source import CharacterSource
    from pipeline.export.quality.report import all_checks
    from pipeline.run.engine.local import reconstruct_to_files


def _what_is_left(paths: Sequence[Path], folder: Path) -> str:
    if not paths:
        return "No result was written."
    return f"Some results are missing: of the files in {folder} these are new, and whole: " + (
        ", ".join(path.name for path in paths) + "."
    )


def print_summary(metrics: Mapping[str, Any], notes: Mapping[Code, str] | None = None) -> None:
    """People, frames, reprojection error, coverage, bone length deviation, and what looks wrong.

    ``notes``: sentences to add to warnings, by code.
    """

    def shown(value: float | None, unit: str, digits: int) -> str:
        return "-" if value is None else f"{value:.{digits}f} {unit}".rstrip()

    print_table(
        ("person", "frames", "reprojection error", "cameras a joint", "coverage", "stature"),
        (
            (
                f"person-{person['id']}",
                f"{person['start_frame']} - {person['start_frame'] + person['num_frames'] - 1}",
                shown(person["reprojection_error_px"], "px", 1),
                shown(person["views_per_joint"], "", 1),
                shown(100 * person["coverage"], "%", 1),
                shown(person["stature_m"], "m", 2),
            )
            for person in metrics["people"]
        ),
    )
    typer.echo(
        f"{metrics['num_frames']} frames at {metrics['frame_rate_hz']:g} Hz; "
        f"median reprojection error {shown(metrics['reprojection_error_px']['median'], 'px', 1)}"
    )
    if rigid := metrics.get("rigid_objects"):
        print_table(
            ("rigid object", "frames with a pose", "points off"),
            (
                (
                    each["name"] if each["person"] is None else f"{each['name']} of person-{each['person']}",
                    shown(100 * each["coverage"], "%", 1),
                    shown(each["rms_mm"], "mm", 1),
                )
                for each in rigid
            ),
        )
    before_and_after = (
        ("bone length deviation", "cm", metrics["bone_length_std_before_cm"], metrics["bone_length_std_cm"]),
        ("jitter", "m/s\u00b2", metrics["jitter_before_m_s2"], metrics["jitter_m_s2"]),
        ("slide of standing feet", "cm", metrics["feet"]["slide_before_cm"], metrics["feet"]["slide_after_cm"]),
    )
    print_table(
        ("measure", "as located", "final"),
        ((name, shown(before, unit, 2), shown(after, unit, 2)) for name, unit, before, after in before_and_after),
    )
    for check in all_checks(metrics):
        warn(" ".join(filter(None, (check.message, (notes or {}).get(check.code)))))


def _character(path: Path | None, bones: Path | None) -> "CharacterSource | None":
    """Character of the options, whose bones are known; raises ``InputError`` before any work."""
    if path is None:
        if bones is not None:
            message = "--bones is the table of a character, but there is none."
            raise InputError([Problem(BONES_INVALID, message, field="bones", hint="Give --character too.")])
        return None
    source = CharacterSource(path, {} if bones is None else read_bone_table(bones))
    source.open()
    return source


def _edits(path: Path | None) -> tuple[PeopleEdit, ...]:
    """Edits in a file: a list, or an object with ``edits`` as the service has it; ``InputError`` if malformed."""
    if path is None:
        return ()
    kind = Annotated[PeopleEdit, Field(discriminator="action")]
    edits: TypeAdapter[tuple[PeopleEdit, ...]] = TypeAdapter(Annotated[tuple[kind, ...], Field(max_length=MAX_EDITS)])
    try:
        document = json.loads(path.read_bytes())
        return edits.validate_python(document.get("edits") if isinstance(document, dict) else document)
    except (OSError, ValueError) as error:
        hint = "Write the edits as in `multicap help people-and-edits`."
        reason = str(error).splitlines()[0]
        raise InputError(
            [Problem(EDITS_UNREADABLE, f"{path.name} can't be read: {reason}", field="edits", hint=hint)]
        ) from error


def _with_laboratory(session: "Session", path: Path, clock: str, place: str | None, up: str) -> "Session":
    """Session with the C3D file of the options; raises ``InputError``."""
    kind, _, channel = clock.partition(":")
    problems, numbers = [], None
    if kind not in get_args(WantedClock) or (channel and kind != "trigger"):
        hint = f"Known are {', '.join(get_args(WantedClock))}, and trigger:CHANNEL."
        problems.append(Problem(PARAMETER_UNREADABLE, f"There is no clock {clock!r}.", field="c3d_clock", hint=hint))
    try:
        numbers = None if place is None else [float(number) for number in place.split(",")]
    except ValueError:
        numbers = []
    if numbers is not None and not is_place(numbers):
        message = f"{place!r} is not X,Y,Z,DEGREES."
        problems.append(Problem(PARAMETER_UNREADABLE, message, field="c3d_place", hint="Write it as 0.5,0,0,90."))
    require(problems)
    return with_laboratory(session, path, cast(WantedClock, kind), channel or None, numbers, known_up(up))


@with_choices()
@with_source()
def command(
    *,
    calibration: Annotated[Path, typer.Option(help="Calibration file: Qualisys QCA, Caliscope/anipose TOML or JSON.")],
    out: Annotated[Path, typer.Option(help="Folder for the results; made if it is missing.")],
    source: SourceOptions,
    more_videos: Annotated[
        list[Path] | None, typer.Argument(metavar="[VIDEOS]...", help="Videos, like --videos.", show_default=False)
    ] = None,
    character: Annotated[
        Path | None,
        typer.Option(
            help="Character that moves as each person: a GLB, VRM or FBX file, see `multicap help own-character`."
        ),
    ] = None,
    c3d: Annotated[
        Path | None,
        typer.Option(
            help="C3D of a laboratory: force plates, analog channels and events, see `multicap help laboratory`."
        ),
    ] = None,
    c3d_clock: Annotated[
        str,
        typer.Option(
            metavar="auto|timecode|trigger[:CHANNEL]|contacts", help="Clock of the beginning of the C3D of --c3d."
        ),
    ] = "auto",
    c3d_place: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,DEGREES", help="Place of the laboratory's axes in the calibration's world, metres."
        ),
    ] = None,
    bones: Annotated[
        Path | None,
        typer.Option(help="Table of the character's bones in JSON, as character.json has it, to correct them."),
    ] = None,
    chosen: Mapping[str, Any],
    edits: Annotated[
        Path | None,
        typer.Option(
            help="Edits of people in JSON, as the service has them, see `multicap help people-and-edits`.",
            show_default=False,
        ),
    ] = None,
    tracking: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Parameter of tracking, see `multicap help tracking`; repeatable."),
    ] = None,
    clustering: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Parameter of clustering, see `multicap help clustering`; repeatable."),
    ] = None,
    provider: ProviderOption = None,
    cache: Annotated[
        Path | None,
        typer.Option(
            help="Folder for intermediate outputs, which later runs reuse. Default: MULTICAP_CACHE_HOME, else the "
            "user's cache folder; at most 2 GiB.",
            show_default=False,
        ),
    ] = None,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Keep and reuse no intermediate outputs.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Reconstruct all people in synchronised videos, or in keypoint files, of calibrated cameras."""
    started_s = time.monotonic()
    paths: list[Path] = []
    with reporting(as_json, lambda: _what_is_left(paths, out)), StageBars(visible=not as_json) as bars:
        source = replace(source, videos=[*(source.videos or []), *(more_videos or [])] or None)
        config = replace(
            checked(chosen, source.check),
            tracking=parameters(tracking or [], "alpha_3d_m=0.2"),
            clustering=parameters(clustering or [], "tau2=0.25"),
            edits=_edits(edits),
        )
        if source.keypoints is None:
            take_provider(provider)
        moved = _character(character, bones)
        session = source.open(calibration)
        if c3d is not None:
            session = _with_laboratory(session, c3d, c3d_clock, c3d_place, source.up)
        if not as_json:
            show_session(session.findings, session.layout)
        sources = (calibration, *(path for path in (source.timestamps, c3d) if path is not None))
        kept = None if no_cache else cache or users_cache()
        require(config_problems(config, session.timebase.num_frames, session.timebase.frame_rate_hz))
        space = session_space(session, config, character)
        require_space(space, out, kept)
        written = reconstruct_to_files(
            session, out, config, bars.update, kept, sources=sources, on_file=paths.append, character=moved
        )
    metrics, warnings = written.metrics, method_warnings(config, source.keypoints is None)
    if moved is not None:
        described = json.loads((out / DESCRIPTION).read_bytes())["warnings"]
        warnings = (*warnings, *map(Finding.from_json, described))
    if config.blur_faces and not (config.overlay or config.report or "rerun" in config.exports):
        message = "Faces are blurred in --overlay, --report and --exports rerun; none was asked for."
        warnings = (*warnings, Finding(NOTHING_BLURRED, message))
    if as_json:
        emit(
            {
                "tracks": [
                    {name: person[name] for name in ("id", "start_frame", "num_frames")} for person in metrics["people"]
                ],
                "metrics": metrics,
                "calibration": metrics["calibration"],
                "sync": metrics["sync"],
                "forced": metrics.get("forced", []),
                "files": [str(path) for path in written.paths],
                "space": document(space),
                "timing_s": {**bars.seconds, "total": time.monotonic() - started_s},
                "reused": bars.reused,
                "warnings": [finding.to_json() for finding in (*session.findings, *warnings)],
            }
        )
        return
    print_summary(metrics)
    if forced := metrics.get("forced"):
        warn(f"The check of the capture found errors: {', '.join(forced)}. The results may be wrong.")
    for warning in warnings:
        warn(warning.message)
    if bars.reused:
        parts = (f"{STAGE_BY_NAME[name].label} ({units})" for name, units in bars.reused.items())
        typer.echo(f"Reused from an earlier run: {', '.join(parts)}; --no-cache computes everything again.")
    for path in written.paths:
        typer.echo(f"  {path}")
