"""Benchmark `export`: speed and memory of writing and reading back all result files of a long take."""

import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from api.cli.benchmark.long_takes import longer_observations, longer_track, peak_rss_mib, to_and_fro
from api.cli.console import JsonOption, emit, print_table, reporting
from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.file_formats import Export, formats_of_people, installed_formats
from pipeline.core.options.rules import require, value_problems
from pipeline.export.character.character_files import write_character_files
from pipeline.export.character.source import CharacterSource
from pipeline.export.results import write_files
from pipeline.motion.skeleton.animate import animate
from pipeline.run.warm_up import warm_up
from pipeline.validation.simulation.scenes import SCENES, record

_SCENE, _NUM_CAMERAS, _DURATION_S = "room", 4, 20.0


def longer_motion(motion: SkeletonMotion, track_id: int, num_frames: int) -> SkeletonMotion:
    """Motion of a person that goes forwards and backwards, with its contacts, up to a number of frames."""
    period = len(motion.root_m)
    contacts = []
    for number, start in enumerate(range(0, num_frames, period)):
        for contact in motion.contacts if number % 2 == 0 else motion.contacts[::-1]:
            first = contact.start_frame if number % 2 == 0 else period - contact.start_frame - contact.num_frames
            if start + first + contact.num_frames <= num_frames:
                contacts.append(replace(contact, start_frame=start + first))
    return replace(
        motion,
        track_id=track_id,
        name=f"person-{track_id}",
        start_frame=0,
        root_m=to_and_fro(motion.root_m, num_frames),
        parent_from_joint=to_and_fro(motion.parent_from_joint, num_frames),
        contacts=tuple(contacts),
    )


def long_take(num_people: int, num_frames: int) -> Reconstruction:
    """Long take of people who repeat the motion of a simulated person forwards and backwards.

    The person with the longest track gives the motion, which is repeated.
    """
    simulation = record(replace(SCENES[_SCENE], duration_s=_DURATION_S), 0, _NUM_CAMERAS)
    cameras, rate_hz = simulation.cameras, simulation.timebase.frame_rate_hz
    people = reconstruct_tracks(
        cameras, simulation.times, simulation.detections, simulation.timebase, derive_parameters(cameras, rate_hz)
    )
    track, seen = max(zip(*people, strict=True), key=lambda person: person[0].num_frames)
    animation = animate([track], [seen], cameras, simulation.timebase, simulation.joints, ReconstructionConfig())
    numbers = range(1, num_people + 1)

    def tracks_of_all(source: Track3D) -> tuple[Track3D, ...]:
        return tuple(replace(longer_track(source, num_frames), track_id=number, start_frame=0) for number in numbers)

    return Reconstruction(
        cameras,
        simulation.joints,
        Timebase(0.0, rate_hz, num_frames),
        tracks_of_all(track),
        tuple(replace(longer_observations(seen, num_frames), track_id=number) for number in numbers),
        Animation(
            tracks_of_all(animation.tracks[0]),
            tuple(longer_motion(animation.motions[0], number, num_frames) for number in numbers),
            animation.floor,
        ),
    )


def measure(
    num_people: int, num_frames: int, exports: Collection[Export], character: CharacterSource | None = None
) -> dict[str, Any]:
    """Measure seconds by kind of file, and the peak memory of the process before and after.

    Files have the people's own skeletons, or a character that moves like each of them.
    """
    take = long_take(num_people, num_frames)
    figure = None if character is None else character.open()
    before_mib = peak_rss_mib()
    seconds: defaultdict[str, float] = defaultdict(float)
    num_bytes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        last_s = started_s = time.perf_counter()

        def count(path: Path) -> None:
            nonlocal last_s
            now_s = time.perf_counter()
            kind = path.name.partition(".")[2] if path.stem.startswith("person-") else path.name
            seconds[kind] += now_s - last_s
            num_bytes[kind] += path.stat().st_size
            last_s = now_s

        if figure is None:
            write_files(take, Path(folder), exports, on_file=count)
        else:
            for result in write_character_files(take, figure, Path(folder), exports):
                count(result.path)
    return {
        "people": num_people,
        "frames": num_frames,
        "wall_s": last_s - started_s,
        "peak_rss_mib": peak_rss_mib(),
        "peak_rss_before_mib": before_mib,
        "seconds": dict(seconds),
        "bytes": dict(num_bytes),
    }


def export(
    people: Annotated[int, typer.Option(min=1, max=100, help="Number of people.")] = 10,
    frames: Annotated[int, typer.Option(min=2, max=1_000_000, help="Number of frames of the take.")] = 10_000,
    exports: Annotated[
        str | None, typer.Option(help="Formats, separated by commas.", show_default="all that are installed")
    ] = None,
    character: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="Time the files of this character instead: GLB, and BVH and FBX if chosen.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Time formats of a long take, from memory to verified files; simulated people, four cameras."""
    with reporting(as_json):
        warm_up()
        chosen = formats_of_people(installed_formats()) if exports is None else tuple(exports.split(","))
        require(value_problems({"exports": chosen}))
        source = None if character is None else CharacterSource(character)
        result = measure(people, frames, cast(Collection[Export], chosen), source)
    if as_json:
        emit(result)
        return
    print_table(
        ("files", "seconds", "MiB"),
        (
            (kind, f"{seconds:.1f}", f"{result['bytes'][kind] / 2**20:.1f}")
            for kind, seconds in result["seconds"].items()
        ),
    )
    typer.echo(
        f"{people} people x {frames} frames in {result['wall_s']:.1f} s; peak memory {result['peak_rss_mib']:.0f} MiB, "
        f"{result['peak_rss_before_mib']:.0f} MiB of it before the first file"
    )
