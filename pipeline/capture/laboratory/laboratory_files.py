"""Add a laboratory's C3D file to a capture session: its content, its place in the world, and its clock."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeVar, get_args

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.calibration.vertical import AXES, turn_upright
from pipeline.capture.laboratory.c3d_content import C3dContent, C3dError, read_content
from pipeline.capture.session import Session
from pipeline.core.data.laboratory import Laboratory, LaboratoryStart
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError, Problem
from pipeline.core.findings import Finding
from pipeline.core.options.job_choices import Up
from pipeline.core.paths import StrPath
from pipeline.core.problems.finding_codes import LABORATORY_READ
from pipeline.core.problems.session_codes import LABORATORY_CLOCK, LABORATORY_UNREADABLE
from pipeline.motion.laboratory.plates import UNITS_M, force_plates, plate_axes, plate_corners_m
from pipeline.video.frame_rate import without_rounding
from pipeline.video.properties.container_clocks import timecode_s

WantedClock = Literal["auto", "timecode", "trigger", "contacts"]
MAX_BYTES = 2**29
# Parameters of channels and plates, which result files hold beside their own.
_MAX_SAMPLES, _MAX_PARAMETERS = 2**26, 40_000
_MAX_PLACE = 1e4
_TRIGGER = re.compile("trig|sync|ttl|start|camera", re.IGNORECASE)
# A trigger has two levels: share of the samples near one of both, and what is near, as a share of their distance.
_TWO_LEVELS, _NEAR = 0.98, 0.15
# Share of a plate's normal along the vertical from which on it lies on the floor.
_LEVEL = 0.9
_Session = TypeVar("_Session", bound=Session)


def with_laboratory(
    session: _Session,
    path: StrPath,
    clock: WantedClock = "auto",
    channel: str | None = None,
    place: Sequence[float] | None = None,
    up: Up = "z",
) -> _Session:
    """Session with a laboratory's C3D file: analog channels, force plates and events.

    - ``session``: videos or keypoints that were recorded at the same time.
    - ``clock``: ``timecode`` of the file and of a video; ``trigger``: a channel rises when the first frame is taken;
      ``contacts``: the feet and the vertical force tell; ``auto``: the first of these that the files allow.
    - ``channel``: name of the trigger channel; ``None``: by its name and its two levels.
    - ``place``: place of the laboratory's axes in the world: x, y, z in metres, and degrees about the vertical;
      ``None``: the calibration has the laboratory's axes.
    - ``up``: axis of the calibration that points up.

    Raises ``InputError`` if the file can't be read, or has no such clock.
    """
    path = Path(path)
    try:
        content = _read(path)
        read = Laboratory(
            path.name, _unit(content), *content[1:5], content.groups, content.events, Rigid3(np.eye(3), np.zeros(3))
        )
        with np.errstate(all="ignore"):
            laboratory = replace(read, world_from_laboratory=_world(read, place, up))
            num_plates, num_corners = len(force_plates(laboratory)), len(plate_corners_m(laboratory))
            start, told = _start(session, laboratory, clock, channel)
    except C3dError as error:
        raise InputError([Problem(LABORATORY_UNREADABLE, str(error), file=path.name)]) from None
    except (ArithmeticError, IndexError, TypeError, ValueError):
        message = "The parameters of the force plates are damaged, or do not fit to the channels."
        raise InputError([Problem(LABORATORY_UNREADABLE, message, file=path.name)]) from None
    channels = f"{laboratory.samples.shape[1]} channels at {laboratory.sample_rate_hz:g} Hz"
    message = f"{path.name} has {channels}, {num_plates} force plates and {len(laboratory.events)} events; {told}"
    if num_plates < num_corners:
        message += f" {num_corners - num_plates} force plates are not read: of another type, or without corners."
    evidence = {"file": path.name, "clock": clock if start is None else start.clock, "num_plates": num_plates}
    finding = Finding(LABORATORY_READ, message, severity="info", evidence=evidence)
    return replace(session, laboratory=replace(laboratory, start=start), findings=(*session.findings, finding))


def is_place(numbers: Sequence[float]) -> bool:
    """True if numbers are a place of ``with_laboratory``."""
    return len(numbers) == 4 and all(abs(number) <= _MAX_PLACE for number in numbers)


def _read(path: Path) -> C3dContent:
    try:
        with path.open("rb") as file:
            stored = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise C3dError(f"The file can't be read: {error.strerror}.") from None
    if len(stored) > MAX_BYTES:
        raise C3dError(f"The file is larger than {MAX_BYTES >> 20} MiB.")
    content = read_content(stored)
    if not content.samples.size:
        raise C3dError("The file has no analog channels, so nothing beside the cameras.")
    if content.samples.size > _MAX_SAMPLES:
        raise C3dError(f"The file has more than {_MAX_SAMPLES:,} samples: cut it.")
    kept = {
        group: {name: value for name, value in content.groups.get(group, {}).items() if name.isprintable()}
        for group in ("ANALOG", "FORCE_PLATFORM")
    }
    values = [value for group in kept.values() for value in group.values()]
    if (
        sum(value.nbytes if isinstance(value, np.ndarray) else len("".join(value)) for value in values)
        > _MAX_PARAMETERS
    ):
        raise C3dError(f"The parameters of the channels have more than {_MAX_PARAMETERS:,} bytes: keep fewer channels.")
    timecodes = [
        text for group in content.groups.values() for name, value in group.items()
        if "TIMECODE" in name and isinstance(value, list) for text in value
    ]  # fmt: skip
    return content._replace(groups=kept | {"POINT": content.groups.get("POINT", {}), "TIMECODE": {"TEXTS": timecodes}})


def _unit(content: C3dContent) -> str:
    units = content.groups["POINT"].get("UNITS", ["mm"])
    unit = str(units[0]).strip().lower() if len(units) else "mm"
    if unit not in UNITS_M:
        raise C3dError(f"The unit of the points is {unit[:8]!r}; known are {', '.join(UNITS_M)}.")
    return unit


def _world(laboratory: Laboratory, place: Sequence[float] | None, up: Up) -> Rigid3:
    """Pose of the laboratory's axes: the calibration's axes, or others in which plates lie, and a stated place."""
    x_m, y_m, z_m, yaw_deg = place or (0.0, 0.0, 0.0, 0.0)
    turn = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    normals = np.array([plate_axes(corners_m)[:, 2] for corners_m in plate_corners_m(laboratory)]).reshape(-1, 3)
    normal = np.nansum(normals, axis=0)
    length = float(np.linalg.norm(normal))
    axes: list[str] = [up] if up in {"z", "-z"} else [up, "z"]
    level = [axis for axis in [*axes, "y", "x"] if abs(normal @ AXES[axis]) >= _LEVEL * length]
    upright = turn_upright(AXES[level[0] if level else up])
    return Rigid3(turn @ upright, np.array([x_m, y_m, z_m]))


def _start(
    session: Session, laboratory: Laboratory, clock: WantedClock, channel: str | None
) -> tuple[LaboratoryStart | None, str]:
    """Time of the first frame by the file itself, and a sentence about it; ``None`` if contacts are to tell."""
    guess = "" if clock != "auto" else " (chosen automatically)"
    start, told = None, f"timecode{guess}"
    if clock in {"auto", "timecode"} and channel is None:
        start = _by_timecode(session, laboratory)
    if start is None and clock in {"auto", "trigger"} and (found := _by_trigger(session, laboratory, channel)):
        start, told = found[0], f"the rise of channel {found[1]}{guess}, at which the first frame is taken"
    if start is not None:
        return start, f"it begins at {start.time_s:.4f} s by {told}, +- {1000 * start.sigma_s:.1f} ms."
    if clock in {"auto", "contacts"} and channel is None and len(plate_corners_m(laboratory)):
        return None, f"contacts and vertical force tell its time{guess}."
    names = ", ".join(laboratory.texts("ANALOG", "LABELS")[:20])
    message = {
        "timecode": "The file or the videos have no timecode.",
        "contacts": "The file has no force plates, so contacts do not tell its time.",
    }.get(clock, f"No channel is a trigger with two levels that rises; the channels are {names}.")
    hint = f"State another clock: {', '.join(get_args(WantedClock))}; or the trigger's channel."
    raise InputError([Problem(LABORATORY_CLOCK, message, file=laboratory.file, field="laboratory", hint=hint)])


def _by_timecode(session: Session, laboratory: Laboratory) -> LaboratoryStart | None:
    """By a parameter whose name has TIMECODE, in frames of a video's timecode."""
    texts = laboratory.texts("TIMECODE", "TEXTS")
    of_videos = {camera: video.timecode for camera, video in session.camera_videos.items() if video.timecode}
    for camera, timecode in of_videos.items():
        rate_hz, day_s = timecode.rate_hz, timecode.day_s
        for time_s in (timecode_s(text, without_rounding(rate_hz)) for text in texts):
            if time_s is not None:
                apart_s = (time_s - timecode.time_s + day_s / 2) % day_s - day_s / 2
                return LaboratoryStart("timecode", session.starts_s[camera] + apart_s, 1.0 / (rate_hz * np.sqrt(12.0)))
    return None


def _by_trigger(session: Session, laboratory: Laboratory, channel: str | None) -> tuple[LaboratoryStart, str] | None:
    """By the first rise of a channel between two levels, which is the first output frame; and the channel's name."""
    for column, name in enumerate(laboratory.texts("ANALOG", "LABELS")[: laboratory.samples.shape[1]]):
        if name == channel or (channel is None and _TRIGGER.search(name)):
            row = _rise(laboratory.channel(column))
            if row is not None:
                period_s = 1.0 / laboratory.sample_rate_hz
                start_s = session.timebase.start_time_s - (row - 0.5) * period_s
                return LaboratoryStart("trigger", start_s, period_s / np.sqrt(12.0)), name
    return None


def _rise(samples: Float[np.ndarray, " samples"]) -> int | None:
    """First row of the upper one of two levels, after the lower one; ``None`` if there are not two."""
    low, high = (float(value) for value in (samples.min(), samples.max()))
    near = np.minimum(np.abs(samples - low), np.abs(samples - high)) < _NEAR * (high - low)
    is_high = samples > (low + high) / 2.0
    rises = np.flatnonzero(is_high[1:] & ~is_high[:-1]) + 1
    return int(rises[0]) if len(rises) and near.mean() >= _TWO_LEVELS else None
