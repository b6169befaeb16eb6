"""The stage that checks a session by its people, from the detections at a few instants."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.capture.keypoints import KeypointSession
from pipeline.config import ReconstructionConfig, networks_of
from pipeline.data import Detections, PafFields
from pipeline.detect.bodies import ImageBodies
from pipeline.detect.chunk import bodies_in, concatenate, stack_bodies
from pipeline.detect.decoders.fields import ImageFields
from pipeline.detect.decoders.grouping import group
from pipeline.detect.entries import entry_of
from pipeline.detect.profiles.detection import BodyDetector, load_detector, load_own
from pipeline.detect.profiles.instants import detect_at
from pipeline.findings import SessionCheck, has_error
from pipeline.joints import JointSet
from pipeline.preflight.people import check_people
from pipeline.preflight.sightings import choose_instants, frames_at, sightings_of
from pipeline.stages.association import DetectionsByCamera, Session
from pipeline.stages.cameras.declared_clocks import check_clocks
from pipeline.stages.plan import FrameCut


def check_at_instants(
    session: Session, config: ReconstructionConfig, on_frame: Callable[[], None] = lambda: None
) -> SessionCheck:
    """Check a session by the people at a few instants, in which they are detected first.

    Of sessions of keypoints, whose people need no detection, the declared times are checked too.

    Parameters
    ----------
    config
        Its detector or profile finds the bodies.
    on_frame
        Called after each frame of a camera.

    Raises
    ------
    InputError, ChildError
        If a video can't be decoded.
    ModelError
        If the detector is not installed.
    """
    frames, num_instants = _frames(session, session.stretches)
    if isinstance(session, KeypointSession):
        check = _checked(session, session.detections, frames, num_instants, session.joints)
        cut = FrameCut(range(session.timebase.num_frames), session.stretches, session.timebase.num_frames)
        return with_clocks(check, session, session.joints, cut, lambda number, part: session.detections)
    body = networks_of(config).body
    detector: BodyDetector = load_own(body) if entry_of(body).own is not None else load_detector(body)
    return _checked(session, detect_at(session, frames, detector, on_frame), frames, num_instants, detector.joints)


def check_session(
    session: Session, joints: JointSet, cut: FrameCut, detected: Callable[[int, range], DetectionsByCamera]
) -> SessionCheck:
    """Check a session by the people at a few instants, wherever its frames are cut.

    Parameters
    ----------
    session
        The whole session, with the calibration as it was given.
    joints
        Joints of the detections.
    cut
        Cut of its wanted frames into ranges.
    detected
        Function that gives the detections of a range by its number and its frames.
    """
    if isinstance(session, KeypointSession):
        return check_bodies(session, session.detections, joints, cut.parts)
    frames, num_instants = _frames(session, cut.parts)
    instants = choose_instants(cut.parts)
    ranges = [
        _at(detected(number, part), frames, joints)
        for number, part in enumerate(cut)
        if any(instant in part for instant in instants)
    ]
    names = [camera.name for camera in session.cameras]
    detections = concatenate([one for part in ranges for one in part.values()], names, len(joints.names))
    return _checked(session, detections, frames, num_instants, joints)


def with_clocks(
    check: SessionCheck,
    session: Session,
    joints: JointSet,
    cut: FrameCut,
    detected: Callable[[int, range], DetectionsByCamera],
) -> SessionCheck:
    """Add the findings about declared times to a check, unless it found errors: those would tell other times."""
    if has_error(check.findings):
        return check
    return replace(check, findings=(*check.findings, *check_clocks(session, joints, cut, detected)))


def check_bodies(
    session: Session, detections: Mapping[str, Detections], joints: JointSet, parts: Sequence[range]
) -> SessionCheck:
    """Check a session by the people at a few instants, with the detections of all its frames."""
    frames, num_instants = _frames(session, parts)
    return _checked(session, detections, frames, num_instants, joints)


def _frames(session: Session, parts: Sequence[range]) -> tuple[Mapping[str, Sequence[int | None]], int]:
    """Frames of each camera at the instants, and the number of instants."""
    instants = choose_instants(parts)
    frames = {name: frames_at(times, session.timebase, instants) for name, times in session.times.items()}
    return frames, len(instants)


def _checked(
    session: Session,
    detections: Mapping[str, Detections],
    frames: Mapping[str, Sequence[int | None]],
    num_instants: int,
    joints: JointSet,
) -> SessionCheck:
    sightings = sightings_of(session.cameras, detections, frames, joints)
    people = {camera.name: sightings.num_people(number) for number, camera in enumerate(session.cameras)}
    return SessionCheck(tuple(check_people(session.cameras, sightings)), people, num_instants)


def _at(
    detected: DetectionsByCamera, frames: Mapping[str, Sequence[int | None]], joints: JointSet
) -> Mapping[str, Detections]:
    """Bodies in some frames of each camera."""
    found = {}
    for name, one in detected.items():
        wanted = sorted({frame for frame in frames[name] if frame is not None})
        if isinstance(one, PafFields):
            found[name] = stack_bodies(name, _grouped(one, wanted, joints), len(joints.names))
        else:
            parts = [bodies_in(one, range(frame, frame + 1)) for frame in wanted]
            found[name] = concatenate(parts, [name], len(joints.names))[name]
    return found


def _grouped(fields: PafFields, wanted: Sequence[int], joints: JointSet) -> list[tuple[int, ImageBodies]]:
    """Bodies of some frames of a camera's peaks and fields."""
    rows = [(frame, int(row)) for frame in wanted for row in np.flatnonzero(fields.frame == frame)]
    return [(frame, group(_image(fields, row), fields.limbs, len(joints.names))) for frame, row in rows]


def _image(fields: PafFields, row: int) -> ImageFields:
    peaks = slice(*np.searchsorted(fields.peak_row, [row, row + 1]))
    return ImageFields(
        fields.peak_joint[peaks], fields.peak_px[peaks], fields.peak_score[peaks], fields.fields[row], fields.grid
    )
