"""`multicap demo`: a real four-camera capture, from videos to animations on disk."""

import time
from pathlib import Path
from typing import Annotated

import typer

from api.commands.reconstruct import print_summary, write_results
from api.console import StageBars, console, reporting
from pipeline import samples
from pipeline.config import ReconstructionConfig
from pipeline.data import Reconstruction
from pipeline.detect import models
from pipeline.export.overlay import draw_skeletons, encode_png
from pipeline.metrics.quality import quality_report
from pipeline.run import reconstruct
from pipeline.session import CaptureSession, open_session
from pipeline.video.decode import decode
from pipeline.video.timeline import frames_in


def write_overlays(session: CaptureSession, reconstruction: Reconstruction, frame: int, folder: Path) -> list[Path]:
    """Draw everybody over one output frame of every camera."""
    timebase = reconstruction.timebase
    start_s = timebase.start_time_s + frame / timebase.frame_rate_hz
    half_s = 0.5 / timebase.frame_rate_hz
    paths = []
    for camera, video in zip(session.cameras, session.videos, strict=True):
        nearest = frames_in(session.times[camera.name], start_s - half_s, start_s + half_s)
        for _, image_rgb in decode(video, nearest.start, nearest.stop):
            picture = draw_skeletons(image_rgb, camera, reconstruction.tracks, frame, reconstruction.joints)
            path = folder / f"overlay-{video.path.stem}.png"
            path.write_bytes(encode_png(picture))
            paths.append(path)
    return paths


def command(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("demo-output"),
) -> None:
    """Reconstruct the sample capture: BVH, JSON, metrics and pictures."""
    started_s = time.monotonic()
    with reporting(as_json=False):
        models.install("movenet-multipose")
        sample = samples.install()
        console.print(sample.attribution)
        with StageBars(visible=True) as bars:
            session = open_session(list(sample.videos.values()), sample.calibration)
            reconstruction = reconstruct(session, ReconstructionConfig(), bars.update)
        paths = write_results(reconstruction, out)
        paths += write_overlays(session, reconstruction, reconstruction.timebase.num_frames // 2, out)
    metrics = quality_report(reconstruction)
    print_summary(reconstruction, metrics)
    console.print(f"{len(session.cameras)} cameras, {time.monotonic() - started_s:.0f} s in all.")
    console.print(f"Results are in {out}/:")
    for path in paths:
        console.print(f"  {path.name}")
