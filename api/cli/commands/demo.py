"""`multicap demo`: reconstruct the sample capture with a temporary service, from upload to pictures."""

import contextlib
import json
import os
import signal
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.reconstruct import print_summary
from api.cli.console import StageBars, console, reporting, shows_help, writing
from pipeline.core.joints import JointSet
from worker.store.spec import JobSpec

if not shows_help():
    import numpy as np
    from jaxtyping import Float

    from api.cli.served import served
    from pipeline.capture.session import CaptureSession, open_session
    from pipeline.core.runtime.packages import samples
    from pipeline.detection import models
    from pipeline.export.overlay import draw_skeletons, encode_png
    from pipeline.motion.body import installed as bodies
    from pipeline.video.decode import decode
    from pipeline.video.timeline import frames_in


def people_at(skeletons: Mapping[str, Any], frame: int) -> 'dict[int, Float[np.ndarray, "joints 3"]]':
    """Joint positions of an output frame by person, from a parsed ``skeletons.json``."""
    unseen = [np.nan] * 3
    return {
        track["id"]: np.array([xyz or unseen for xyz in track["positions_m"][frame - track["start_frame"]]])
        for track in skeletons["tracks"]
        if 0 <= frame - track["start_frame"] < len(track["positions_m"])
    }


def write_overlays(session: "CaptureSession", skeletons: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw all people over the middle frame of every camera."""
    frame = skeletons["num_frames"] // 2
    people_m = people_at(skeletons, frame)
    joints = JointSet(tuple(skeletons["joint_names"]), tuple((start, end) for start, end in skeletons["bones"]))
    start_s = skeletons["start_time_s"] + frame / skeletons["frame_rate_hz"]
    half_s = 0.5 / skeletons["frame_rate_hz"]
    paths = []
    for camera, video in zip(session.cameras, session.videos, strict=True):
        nearest = frames_in(session.times[camera.name], start_s - half_s, start_s + half_s)
        for _, image_rgb in decode(video, nearest.start, nearest.stop):
            path = folder / f"overlay-{video.path.stem}.png"
            picture = encode_png(draw_skeletons(image_rgb, camera, people_m, joints))
            with writing(path):
                path.write_bytes(picture)
            paths.append(path)
    return paths


def command(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("demo-output"),
    keep: Annotated[bool, typer.Option("--keep", help="Leave the service running until Ctrl-C.")] = False,
) -> None:
    """Start the service, send it the sample capture, download BVH, JSON and metrics, and draw pictures."""
    started_s = time.monotonic()
    with reporting(as_json=False), tempfile.TemporaryDirectory(prefix="multicap-") as data_dir:
        with writing(out):
            out.mkdir(parents=True, exist_ok=True)
        models.install_networks(JobSpec().config)
        bodies.install()
        sample = samples.install()
        console.print(sample.attribution)
        videos = list(sample.videos.values())
        with served(Path(data_dir), workers=os.cpu_count() or 1) as client:
            console.print(f"The service runs at {client.url}. Sending {len(videos)} videos.")
            job = client.submit("Sample capture", videos, sample.calibration)
            with StageBars(visible=True) as bars:
                job = client.follow(job, bars.update_job)
            with writing(out):
                paths = client.download(job, out)
            skeletons, metrics = (json.loads((out / name).read_bytes()) for name in ("skeletons.json", "metrics.json"))
            paths += write_overlays(open_session(videos, sample.calibration), skeletons, out)
            print_summary(metrics, samples.NOTES)
            console.print(f"{len(videos)} cameras, {time.monotonic() - started_s:.0f} s in all.")
            console.print(f"Results are in {out}/:")
            for path in paths:
                console.print(f"  {path.name}")
            if keep:
                typer.echo(f"The service keeps running at {client.url}. Ctrl-C stops it.")
                signal.signal(signal.SIGTERM, signal.default_int_handler)
                with contextlib.suppress(KeyboardInterrupt):
                    signal.pause()
