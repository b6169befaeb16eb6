"""Check of a session, of videos or of keypoints, by the people at a few instants."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.capture.session import Session
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections, DetectionsByCamera, PafFields
from pipeline.core.findings import SessionCheck, has_error
from pipeline.core.joints import JointSet
from pipeline.detection.bodies import ImageBodies
from pipeline.detection.chunk import concatenate, stack_bodies
from pipeline.detection.decoders.fields import ImageFields
from pipeline.detection.decoders.grouping import group
from pipeline.run.preflight.declared_clocks import DetectionsNear, check_clocks
from pipeline.run.preflight.people import check_people
from pipeline.run.preflight.sightings import choose_instants, frames_at, sightings_of


def check_detections(session: Session, near: DetectionsNear, joints: JointSet, parts: Sequence[range]) -> SessionCheck:
    """Check a session by the people at a few instants, wherever its frames are cut.

    The session is whole, with the calibration as it was given. ``near`` gives the detections of the ranges that have
    some of given output frames; ``parts`` are the wanted output frames.
    """
    frames = frames_at_instants(session.times, session.timebase, parts)
    instants = [range(instant, instant + 1) for instant in choose_instants(parts)]
    ranges = [_at(detected, frames, joints) for detected in near(instants)]
    names = [camera.name for camera in session.cameras]
    detections = concatenate([bodies for part in ranges for bodies in part.values()], names, len(joints.names))
    return check_bodies(session, detections, joints, parts)


def with_clocks(
    check: SessionCheck, session: Session, near: DetectionsNear, joints: JointSet, parts: Sequence[range]
) -> SessionCheck:
    """Add the findings about declared times to a check, unless cameras are wrong or nobody is located.

    Arguments are as of ``check_detections``; the detections are whole bodies.
    """
    if has_error(check.findings) or not check.num_located:
        return check
    return replace(check, findings=(*check.findings, *check_clocks(session, near, joints, parts)))


def check_bodies(
    session: Session, detections: Mapping[str, Detections], joints: JointSet, parts: Sequence[range]
) -> SessionCheck:
    """Check a session by the people at a few instants, with the detections at least of these instants."""
    instants = choose_instants(parts)
    time_s = [session.timebase.time_s(instant) for instant in instants]
    frames = frames_at_instants(session.times, session.timebase, parts)
    sightings = sightings_of(session.cameras, detections, frames, joints, time_s)
    people = {camera.name: sightings.num_people(number) for number, camera in enumerate(session.cameras)}
    checked = check_people(session.cameras, sightings)
    return SessionCheck(checked.findings, people, len(instants), checked.num_located)


def frames_at_instants(
    times: Mapping[str, FrameTimes], timebase: Timebase, parts: Sequence[range]
) -> Mapping[str, Sequence[int | None]]:
    """Frames of each camera at the instants of a check, in given output frames."""
    instants = choose_instants(parts)
    return {name: frames_at(taken, timebase, instants) for name, taken in times.items()}


def _at(
    detected: DetectionsByCamera, frames: Mapping[str, Sequence[int | None]], joints: JointSet
) -> Mapping[str, Detections]:
    """Bodies in some frames of each camera."""
    bodies = {}
    for name, seen in detected.items():
        wanted = sorted({frame for frame in frames[name] if frame is not None})
        if isinstance(seen, PafFields):
            bodies[name] = stack_bodies(name, _grouped(seen, wanted, joints), len(joints.names))
        else:
            parts = [seen.within(range(frame, frame + 1)) for frame in wanted]
            bodies[name] = concatenate(parts, [name], len(joints.names))[name]
    return bodies


def _grouped(fields: PafFields, wanted: Sequence[int], joints: JointSet) -> list[tuple[int, ImageBodies]]:
    """Bodies of some frames of a camera's peaks and fields."""
    rows = [(frame, int(row)) for frame in wanted for row in np.flatnonzero(fields.frame == frame)]
    return [(frame, group(_image(fields, row), fields.limbs, len(joints.names))) for frame, row in rows]


def _image(fields: PafFields, row: int) -> ImageFields:
    peaks = slice(*np.searchsorted(fields.peak_row, [row, row + 1]))
    return ImageFields(
        fields.peak_joint[peaks], fields.peak_px[peaks], fields.peak_score[peaks], fields.fields[row], fields.grid
    )
