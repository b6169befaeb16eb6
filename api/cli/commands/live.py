"""`multicap live`: cameras or streams in, people out, while it happens."""

import contextlib
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli import options
from api.cli.console import JsonOption, console, print_table, reporting, shows_help
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.config import PROFILES, MotionChoices
from pipeline.core.options.rules import collecting, require
from pipeline.core.problems.finding_codes import OUTPUT_EXISTS
from pipeline.core.problems.request_codes import VALUE_NOT_ALLOWED
from pipeline.core.problems.session_codes import CALIBRATION_MISSING
from pipeline.run.live.cameras.sources import read_sources
from pipeline.run.live.outputs.addresses import OUTPUTS, example

if not shows_help():
    from api.cli.live.outputs import JsonLines, KeptKeypoints, ListenerGroup, Terminal, opened_output, summary_line
    from api.cli.live.preview import PreviewPage
    from pipeline.calibration.registry import read_calibration
    from pipeline.core.data.cameras import Camera
    from pipeline.run.live.cameras.listeners import OutputListener, PatternRun, capture
    from pipeline.run.live.cameras.run import CameraRun
    from pipeline.run.live.cameras.totals import LiveTotals
    from pipeline.run.live.outputs.runner import LiveOutputs


@options.with_choices("joints", "appearance")
def command(
    calibration: Annotated[Path | None, typer.Option(help="Calibration file, like multicap reconstruct.")] = None,
    camera: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CAMERA=SOURCE",
            help="Source of a camera: rtsp://..., http://... (MJPEG, MPEG-TS), a device (/dev/video0), or a video "
            "file, which is played at its own pace. Repeatable.",
        ),
    ] = None,
    *,
    test_pattern: Annotated[
        bool, typer.Option("--test-pattern", help="Send a simulated person in place of cameras, to set up receivers.")
    ] = False,
    units: options.UnitsOption = None,
    up: options.UpOption = "z",
    profile: Annotated[
        str, typer.Option(metavar="|".join(PROFILES), help="Networks that find the 2D joints, by speed and accuracy.")
    ] = "fast",
    chosen: Mapping[str, Any],
    provider: options.ProviderOption = None,
    sync: Annotated[
        float | None,
        typer.Option(
            min=3.0,
            max=25.0,
            metavar="SECONDS",
            help="Find constant offsets of the cameras' clocks from the people of the first seconds, 3 to 25.",
        ),
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option(
            metavar="URL", help=f"Program that gets the people: {', '.join(map(example, OUTPUTS))}. Repeatable."
        ),
    ] = None,
    allow_network: Annotated[bool, typer.Option("--allow-network", help="Allow outputs to other machines.")] = False,
    lines: Annotated[
        Path | None, typer.Option(help="New file for the people of each instant, a line of JSON each.")
    ] = None,
    keep: Annotated[
        Path | None, typer.Option(help="New folder for the keypoints, as a session that multicap reconstruct takes.")
    ] = None,
    preview: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Port on loopback of a page with the people in 3D; 0 for a free one."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Capture people live from cameras, streams or files, until Ctrl-C or the end of the files.

    With --json each instant is a line of JSON on stdout.
    """
    with reporting(as_json), contextlib.ExitStack() as opened:
        choices = options.checked({**chosen, "profile": profile})
        options.take_provider(provider)
        with collecting() as collect:
            cameras: tuple[Camera, ...] = ()
            sources = None
            if test_pattern:
                collect(lambda: require(_with_pattern(calibration=calibration, camera=camera, sync=sync, keep=keep)))
            else:
                cameras = collect(lambda: _read_cameras(calibration, units, up)) or ()
                names = [known.name for known in cameras]
                sources = collect(lambda: read_sources(camera or (), names)) if cameras else None
            outputs = collect(lambda: opened.enter_context(LiveOutputs(output or (), allow_network=allow_network)))
            collect(lambda: require([*_existing_files(keep, lines)]))
            page = None if preview is None else collect(lambda: opened.enter_context(PreviewPage(preview)))
        by_name = {known.name: known for known in cameras}
        listener = ListenerGroup()
        run: CameraRun | PatternRun = PatternRun(listener)
        if sources is not None:
            run = CameraRun([by_name[source.camera] for source in sources], sources, choices, listener, sync)
        if as_json:
            listener.add(JsonLines(sys.stdout))
        if lines is not None:
            listener.add(JsonLines(opened.enter_context(opened_output(lines))))
        if output:
            listener.add(OutputListener(outputs, run.totals))
        if keep is not None:
            listener.add(KeptKeypoints(keep))
        if page is not None:
            listener.add(page)
            console.print(f"Preview: {page.url}")
        if not as_json:
            listener.add(Terminal(opened.enter_context(console.status("Opening the cameras ..."))))
        with _stopped_by_signals(run.stop):
            _execute(run, choices)
        listener.end(run.totals)
        if not as_json:
            _print_summary(run.totals)
        if listener.errors:
            raise listener.errors[0]


def _read_cameras(calibration: Path | None, units: str | None, up: str) -> "tuple[Camera, ...]":
    if calibration is None:
        hint = "Give --calibration and --camera, or --test-pattern for a simulated person."
        problem = Problem(CALIBRATION_MISSING, "There is no calibration.", field="calibration", hint=hint)
        raise InputError([problem])
    return read_calibration(calibration, options.known_units(units), options.known_up(up))


def _with_pattern(**stated: object) -> Iterator[Problem]:
    for name, value in stated.items():
        if value:
            message = f"A test pattern has no {name}: its person is simulated."
            yield Problem(VALUE_NOT_ALLOWED, message, field=name, hint=f"Omit --{name}, or --test-pattern.")


def _execute(run: "CameraRun | PatternRun", choices: MotionChoices) -> None:
    if isinstance(run, CameraRun):
        capture(run, choices)
    else:
        run.run()


def _existing_files(keep: Path | None, lines: Path | None) -> Iterator[Problem]:
    if keep is not None and keep.exists() and (not keep.is_dir() or any(keep.iterdir())):
        message = "There are files already."
        yield Problem(OUTPUT_EXISTS, message, file=keep.name, field="keep", hint="Name a new or empty folder.")
    # Devices and pipes are there already, and so is an empty file of a try without cameras.
    if lines is not None and lines.is_file() and lines.stat().st_size:
        message = "The file is there already."
        yield Problem(OUTPUT_EXISTS, message, file=lines.name, field="lines", hint="Name a new file.")


@contextlib.contextmanager
def _stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """End the capture at the first SIGINT or SIGTERM; another one interrupts as usual."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.getsignal(number) for number in numbers}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def stop_once(*_: object) -> None:
        restore()
        stop()

    for number in numbers:
        signal.signal(number, stop_once)
    try:
        yield
    finally:
        restore()


def _print_summary(totals: "LiveTotals") -> None:
    """Frames of each camera, packets of each output, then rate, people and latency."""
    if totals.cameras:
        print_table(
            ("camera", "frames", "detected", "dropped", "times lost"),
            (
                (camera.name, str(camera.decoded), str(camera.detected), str(camera.dropped), str(camera.lost))
                for camera in totals.cameras
            ),
        )
    if totals.outputs:
        print_table(
            ("output", "state", "sent", "dropped", "failed"),
            (
                (
                    output.address,
                    output.message or output.state,
                    str(output.sent),
                    str(output.dropped),
                    str(output.failed),
                )
                for output in totals.outputs
            ),
        )
    p99 = totals.latencies.percentile_ms(99)
    typer.echo(summary_line(totals, f"{totals.people} people in all") + ("" if p99 is None else f", p99 {p99:.0f} ms"))
