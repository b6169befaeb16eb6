"""The report of a take: contents from the reconstruction and its session, pictures from the videos."""

from collections.abc import Mapping
from contextlib import closing
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from jaxtyping import UInt8

from pipeline.capture.keypoints import KeypointSession
from pipeline.choices import Choice
from pipeline.config import CHOICES, ReconstructionConfig, networks_of
from pipeline.data import Reconstruction
from pipeline.detect.entries import entry_of
from pipeline.edits import document_of
from pipeline.errors import InputError
from pipeline.export.overlay import given_names, people_at
from pipeline.progress import OnShare
from pipeline.quality.report import all_checks, quality_report
from pipeline.quality.views import views_of
from pipeline.report.motion import motion_of
from pipeline.report.page import ReportContents, Rows, encode_page
from pipeline.report.pictures import MAX_PICTURES, Moment, Picture, draw_picture, moments_of
from pipeline.stages.association import Session
from pipeline.stages.code import LIBRARIES
from pipeline.stages.inputs import Context, on_clocks
from pipeline.stages.output import ResultFile
from pipeline.stages.results.assembly import assemble
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.visual_choices import REPORT_KIND

REPORT = "report.html"
"""Name of the report's file."""


def report_file(context: Context, on_share: OnShare) -> ResultFile:
    """Write the report of a job into the folder for result files."""
    path = context.scratch / REPORT
    path.write_bytes(encode_page(_contents(context, assemble(context), on_share)))
    return ResultFile(path.name, REPORT_KIND, None, "text/html; charset=utf-8", path)


def _contents(context: Context, take: Reconstruction, on_share: OnShare) -> ReportContents:
    session, _ = on_clocks(context, context.outline())
    views = views_of(take)
    metrics, motion, origin = quality_report(take, views), motion_of(take, views), context.origin()
    pictures: list[Picture] = []
    notes: list[str] = []
    shown = take.cameras[:MAX_PICTURES]
    wanted = [(moment, camera.name) for moment in moments_of(motion, len(shown)) for camera in shown]
    for number, (moment, camera) in enumerate(wanted):
        on_share(0.5 + 0.5 * number / len(wanted))
        try:
            picture = _picture(context, session, take, camera, moment)
        except InputError as error:
            notes.append(f"No picture of {camera}: {error.problems[0].message}")
            continue
        if picture is None:
            notes.append(f"{camera} took no picture at frame {moment.frame}.")
        else:
            pictures.append(picture)
    on_share(1.0)
    if len(take.cameras) > MAX_PICTURES:
        notes.append(f"Pictures are of the first {MAX_PICTURES} of {len(take.cameras)} cameras.")
    errors_px = metrics["reprojection_error_px"]["by_camera"]
    return ReportContents(
        name=origin.name,
        motion=motion,
        metrics=metrics,
        findings=[*session.findings, *all_checks(metrics)],
        pictures=pictures,
        notes=notes,
        settings=settings_of(context.config),
        versions=_versions(context.config, has_videos=not isinstance(session, KeypointSession)),
        inputs=tuple(origin.files.items()),
        cameras=[
            (camera.name, f"{camera.size_px[0]} x {camera.size_px[1]}", _pixels(errors_px.get(camera.name)))
            for camera in take.cameras
        ],
    )


def _picture(context: Context, session: Session, take: Reconstruction, camera: str, moment: Moment) -> Picture | None:
    """Picture of a camera at a moment; ``None`` if it took none within an interval of its own frames."""
    (of_take,) = (one for one in take.cameras if one.name == camera)
    own_s = session.times[camera].time_s
    wanted_s = take.timebase.time_s(moment.frame)
    interval_s = max(1.0 / take.timebase.frame_rate_hz, float(np.median(np.diff(own_s))) if len(own_s) > 1 else 0.0)
    number = int(np.abs(own_s - wanted_s).argmin()) if len(own_s) else 0
    if not len(own_s) or abs(own_s[number] - wanted_s) > interval_s:
        return None
    time_s = float(own_s[number])
    image_rgb = None
    if not isinstance(session, KeypointSession):
        image_rgb = _decoded(
            context, session.videos[[one.name for one in session.cameras].index(camera)], camera, number
        )
        if image_rgb is None:
            return None
    people_m = people_at(take.tracks, take.timebase, time_s)
    size_px, jpeg = draw_picture(image_rgb, of_take, people_m, take.joints, given_names(take.motions))
    return Picture(moment, camera, time_s, size_px, jpeg)


def _decoded(
    context: Context, video: VideoInfo, camera: str, number: int
) -> UInt8[np.ndarray, "height width 3"] | None:
    """A frame of a video; ``None`` if its decoder left it out."""
    with context.video(camera), closing(decode(video, number, number + 1)) as frames:
        return next((image_rgb.copy() for _, image_rgb in frames), None)


def settings_of(config: ReconstructionConfig) -> Rows:
    """Choices of a reconstruction as labels and words, with a mark of those that differ from the usual ones."""
    rows: list[tuple[str, ...]] = []
    for choice in CHOICES.values():
        value = getattr(config, choice.name)
        rows.append((choice.about.label, _words(choice, value), "yes" if value == choice.default else "no"))
    parameters = {**config.tracking, **config.clustering}
    rows += [(f"Parameter {name}", f"{value:g}", "no") for name, value in parameters.items()]
    rows += [("Edit of people", _edit_words(document_of(edit)), "no") for edit in config.edits]
    return rows


def _words(choice: Choice, value: Any) -> str:
    if value is None:
        return str(choice.about.unset)
    if choice.kind == "flag":
        return "yes" if value else "no"
    if choice.kind == "frame_range":
        return f"{value[0]} to {value[1] - 1}"
    names = value if choice.kind == "several" else (value,)
    return ", ".join(choice.values[name].label if name in choice.values else str(name) for name in names)


def _edit_words(edit: Mapping[str, Any]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in edit.items())


def _versions(config: ReconstructionConfig, has_videos: bool) -> Rows:
    rows = [(name, found) for name in ("multicap", *LIBRARIES) if (found := _version(name)) is not None]
    if has_videos:
        rows += [(f"network {name}", f"SHA-256 {entry_of(name).sha256}") for name in networks_of(config).names]
    return rows


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def _pixels(error_px: float | None) -> str:
    return "-" if error_px is None else f"{error_px:.1f} px"
