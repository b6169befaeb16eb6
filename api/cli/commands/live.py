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
from pipeline.core.errors import Problem
from pipeline.core.options.config import PROFILES
from pipeline.core.options.rules import collecting, require
from pipeline.core.problems.finding_codes import OUTPUT_EXISTS
from pipeline.run.live.cameras.sources import read_sources

if not shows_help():
    from api.cli.live.outputs import JsonLines, KeptKeypoints, ListenerGroup, Terminal, opened_output, summary_line
    from api.cli.live.preview import PreviewPage
    from pipeline.calibration.registry import read_calibration
    from pipeline.run.live.cameras.listeners import OutputListener, capture
    from pipeline.run.live.cameras.run import CameraRun
    from pipeline.run.live.cameras.totals import LiveTotals
    from pipeline.run.live.outputs.runner import LiveOutputs


@options.with_choices("joints", "appearance")
def command(
    calibration: Annotated[Path, typer.Option(help="Calibration file, like multicap reconstruct.")],
    camera: Annotated[
        list[str],
        typer.Option(
            metavar="CAMERA=SOURCE",
            help="Source of a camera: rtsp://..., http://... (MJPEG, MPEG-TS), a device (/dev/video0), or a video "
            "file, which is played at its own pace. Repeatable.",
        ),
    ],
    *,
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
        typer.Option(metavar="URL", help="Program that gets the people, such as vmc://127.0.0.1:39539. Repeatable."),
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
            cameras = (
                collect(lambda: read_calibration(calibration, options.known_units(units), options.known_up(up))) or ()
            )
            sources = collect(lambda: read_sources(camera, [known.name for known in cameras])) if cameras else None
            outputs = collect(lambda: opened.enter_context(LiveOutputs(output or (), allow_network=allow_network)))
            collect(lambda: require([*_existing_files(keep, lines)]))
            page = None if preview is None else collect(lambda: opened.enter_context(PreviewPage(preview)))
        by_name = {known.name: known for known in cameras}
        listener = ListenerGroup()
        run = CameraRun([by_name[source.camera] for source in sources or ()], sources or (), choices, listener, sync)
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
            capture(run, choices)
        listener.end(run.totals)
        if not as_json:
            _print_summary(run.totals)
        if listener.errors:
            raise listener.errors[0]


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
    """Frames of each camera, then rate, people and latency."""
    print_table(
        ("camera", "frames", "detected", "dropped", "times lost"),
        (
            (camera.name, str(camera.decoded), str(camera.detected), str(camera.dropped), str(camera.lost))
            for camera in totals.cameras
        ),
    )
    p99 = totals.latencies.percentile_ms(99)
    typer.echo(summary_line(totals, f"{totals.people} people in all") + ("" if p99 is None else f", p99 {p99:.0f} ms"))
