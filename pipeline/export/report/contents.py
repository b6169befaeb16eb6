"""Contents of the report of a take: figures and motion from the reconstruction, pictures from the videos."""

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy.lib.recfunctions import repack_fields

from pipeline.capture.session import Session
from pipeline.core.data.detections import HeadRegions
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import InputError
from pipeline.core.options.choices import Choice
from pipeline.core.options.config import CHOICES, ReconstructionConfig
from pipeline.core.options.edits import edit_document
from pipeline.core.progress import OnShare
from pipeline.detection.entries import find_entry
from pipeline.export.overlay import given_names, people_at
from pipeline.export.person_files import force_figures, take_people
from pipeline.export.privacy.blur import blur_ellipses
from pipeline.export.quality.force_checks import force_checks
from pipeline.export.quality.report import all_checks, quality_report
from pipeline.export.quality.views import PersonViews, person_views, without_fingers
from pipeline.export.report.biomechanics import MAX_PEOPLE, PersonAngles
from pipeline.export.report.page import ReportContents, Rows
from pipeline.export.report.pictures import MAX_PICTURES, Moment, Picture, choose_moments, draw_picture, presence
from pipeline.export.viewer.description import ViewerMotion
from pipeline.export.viewer.frames import Arrows, force_arrows_m
from pipeline.motion.angles.compute import joint_angles
from pipeline.motion.body.installed import find as find_body
from pipeline.motion.body.shape import BodyShapes
from pipeline.motion.forces.person_forces import PersonForces
from pipeline.motion.gait.analysis import analyse_gait
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo

ReadVideo = Callable[[str], AbstractContextManager[None]]
"""Gives the block in which the video of a camera can be read, by the camera's name."""
ReadHeads = Callable[[str], HeadRegions | None]
"""Gives the heads that are blurred in the pictures of a camera, by the camera's name; ``None``: none are."""


def gather_contents(
    session: Session,
    take: Reconstruction,
    config: ReconstructionConfig,
    versions: Rows,
    name: str,
    inputs: Mapping[str, str],
    reading: ReadVideo,
    heads: ReadHeads,
    on_share: OnShare,
) -> ReportContents:
    """Gather the contents of a report.

    The session is on measured clocks if they were measured. ``versions`` are as ``list_versions`` gives them,
    ``inputs`` SHA-256 of the take's files by name.
    """
    views = person_views(take)
    metrics = quality_report(take, views)
    # Forces of each person are computed once, for the figures, the plots and the arrows.
    forces = dict[int, PersonForces]()
    if "forces" in config.exports:
        metrics["forces"] = force_figures(take_people(take, "person", "capsules"), forces.__setitem__)
        metrics["capture_checks"] = [*metrics["capture_checks"], *force_checks(take, metrics["forces"])]
    pictures: list[Picture] = []
    notes: list[str] = []
    shown = take.cameras[:MAX_PICTURES]
    moments = choose_moments(*presence(take, views), len(shown))
    wanted = [(moment, camera.name) for moment in moments for camera in shown]
    for number, (moment, camera) in enumerate(wanted):
        on_share(0.5 + 0.5 * number / len(wanted))
        try:
            picture = _picture(reading, heads, session, take, camera, moment)
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
        name=name,
        motion=embed_motion(
            take,
            views,
            metrics,
            find_body(),
            arrows_m={number: force_arrows_m(of_person) for number, of_person in forces.items()},
        ),
        metrics=metrics,
        angles=_person_angles(take, metrics, forces),
        findings=[*session.findings, *all_checks(metrics)],
        pictures=pictures,
        notes=notes,
        settings=list_settings(config),
        versions=versions,
        inputs=tuple(inputs.items()),
        cameras=[
            (camera.name, f"{camera.size_px[0]} x {camera.size_px[1]}", _pixels(errors_px.get(camera.name)))
            for camera in take.cameras
        ],
    )


def _person_angles(
    take: Reconstruction, metrics: Mapping[str, Any], forces: Mapping[int, PersonForces]
) -> list[PersonAngles]:
    """Joint angles of the first people with any known angle."""
    ranges = {person["id"]: person["angles"] for person in metrics["people"]}
    people = zip(take.tracks, take.motions, strict=True)
    known = [(track, motion) for track, motion in people if ranges[track.track_id]]
    return [
        PersonAngles(
            motion.name,
            joint_angles(motion, track, take.joints),
            ranges[track.track_id],
            analyse_gait(without_fingers(track, take.joints), take.joints, take.timebase.frame_rate_hz).strides,
            forces.get(track.track_id),
        )
        for track, motion in known[:MAX_PEOPLE]
    ]


def _picture(
    reading: ReadVideo, heads: ReadHeads, session: Session, take: Reconstruction, camera: str, moment: Moment
) -> Picture | None:
    """Picture of a camera at a moment; ``None`` if it took none within an interval of its own frames."""
    (shown,) = (known for known in take.cameras if known.name == camera)
    own_s = session.times[camera].time_s
    wanted_s = take.timebase.time_s(moment.frame)
    interval_s = max(1.0 / take.timebase.frame_rate_hz, float(np.median(np.diff(own_s))) if len(own_s) > 1 else 0.0)
    number = int(np.abs(own_s - wanted_s).argmin()) if len(own_s) else 0
    if not len(own_s) or abs(own_s[number] - wanted_s) > interval_s:
        return None
    time_s = float(own_s[number])
    image_rgb = None
    if (video := session.camera_videos.get(camera)) is not None:
        with reading(camera):
            image_rgb = _decoded(video, number)
        if image_rgb is None:
            return None
        if (regions := heads(camera)) is not None:
            image_rgb = blur_ellipses(image_rgb, regions.in_frame(number, shown.size_px))
    people_m = people_at(take.tracks, take.timebase, time_s)
    size_px, jpeg = draw_picture(image_rgb, shown, people_m, take.joints, given_names(take.motions))
    return Picture(moment, camera, time_s, size_px, jpeg)


def _decoded(video: VideoInfo, number: int) -> UInt8[np.ndarray, "height width 3"] | None:
    """A frame of a video; ``None`` if its decoder left it out."""
    with closing(decode(video, number, number + 1)) as frames:
        return next((image_rgb.copy() for _, image_rgb in frames), None)


def list_settings(config: ReconstructionConfig) -> Rows:
    """Choices of a reconstruction as labels and words, with a mark of those that differ from the usual ones."""
    rows: list[tuple[str, ...]] = []
    for choice in CHOICES.values():
        value = getattr(config, choice.name)
        rows.append((choice.about.label, _words(choice, value), "yes" if value == choice.default else "no"))
    parameters = {**config.tracking, **config.clustering}
    rows += [(f"Parameter {name}", f"{value:g}", "no") for name, value in parameters.items()]
    rows += [("Edit of people", _edit_words(edit_document(edit)), "no") for edit in config.edits]
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
    return ", ".join(f"{name.replace('_', ' ')} {_named(value)}" for name, value in edit.items())


def _named(value: Any) -> str:
    """Value of an edit: a person by a place, or a number, a frame, a name."""
    if not isinstance(value, Mapping):
        return str(value)
    return f"at ({', '.join(f'{axis:.2f}' for axis in value['place_m'])}) in frame {value['frame']}"


def list_versions(distributions: Sequence[str], networks: Sequence[str]) -> Rows:
    """Versions of this program and of the installed ones among some distributions, and digests of networks."""
    rows = [(name, installed) for name in ("multicap", *distributions) if (installed := _version(name)) is not None]
    return [*rows, *((f"network {name}", f"SHA-256 {find_entry(name).sha256}") for name in networks)]


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def _pixels(error_px: float | None) -> str:
    return "-" if error_px is None else f"{error_px:.1f} px"


MAX_MOTION_BYTES = 4 * 2**20
"""Largest size of the motion in 3D; of a longer take each n-th frame is kept."""

# Fields of the records that are drawn.
_FIELDS = ["origin_m", "joints", "skeleton", "forces"]


def embed_motion(
    take: Reconstruction,
    views: Sequence[PersonViews],
    metrics: Mapping[str, Any],
    shapes: BodyShapes | None = None,
    max_bytes: int = MAX_MOTION_BYTES,
    arrows_m: Arrows = MappingProxyType({}),
) -> dict[str, Any]:
    """Describe a take as ``motion.json`` does, with its frames inside.

    ``metrics`` is the content of ``metrics.json``; people have human bodies if there are ``shapes``, and arrows if they
    have forces. ``stride`` is the number of output frames from one kept frame to the next; ``frames`` has the records
    of these of each person, in base64.
    """
    motion = ViewerMotion(take, views, {}, metrics, shapes=shapes, arrows_m=arrows_m)
    fields = [name for name in _FIELDS if name in (motion.dtype.names or ())]
    dtype = repack_fields(motion.dtype[fields], align=True)
    stride = choose_stride([track.num_frames for track in take.tracks], dtype.itemsize, max_bytes)
    frames = [track.start_frame + np.arange(track.num_frames) for track in take.tracks]
    is_kept = np.concatenate([np.zeros(0, int), *frames]) % stride == 0
    kept, done = [], 0
    for block in motion.encode():
        records = np.frombuffer(block, motion.dtype)
        drawn = records[is_kept[done : done + len(records)]]
        thin = np.zeros(len(drawn), dtype)
        for name in fields:
            thin[name] = drawn[name]
        kept.append(thin.tobytes())
        done += len(records)
    document: dict[str, Any] = json.loads(motion.describe())
    document["record"]["num_bytes"] = dtype.itemsize
    places: dict[str, Any] = dict(dtype.fields or {})
    document["record"]["offsets"] = {name: places[name][1] for name in fields}
    return {**document, "stride": stride, "frames": base64.b64encode(b"".join(kept)).decode("ascii")}


def choose_stride(num_frames: Sequence[int], record_bytes: int, max_bytes: int) -> int:
    """Choose the smallest stride with which records are at most as large as wanted, or one for each person.

    ``num_frames`` are the people's numbers of frames.

    >>> choose_stride([300, 300], 100, 20_000)
    3
    """
    stride = 1
    while any(num > stride for num in num_frames) and sum(-(-num // stride) for num in num_frames) > max(
        1, max_bytes // max(1, record_bytes)
    ):
        stride += max(1, stride // 8)
    return stride
