"""Check of a session, of videos or of keypoints, by the people at a few instants.

It has findings about cameras that hang turned, and about declared clocks, too.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import Session
from pipeline.capture.synchronization.remaining import MAX_PAIRS, RemainingOffset, remaining_offsets
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections, DetectionsByCamera, PafFields
from pipeline.core.findings import Finding, SessionCheck, has_error
from pipeline.core.joints import JointSet
from pipeline.core.problems.finding_codes import CAMERA_HANGS_TURNED, CLOCKS_DISAGREE, CLOCKS_UNCHECKED
from pipeline.detection.bodies import ImageBodies, concatenate, stack_bodies
from pipeline.run.session_check.people import check_people
from pipeline.run.session_check.sightings import choose_instants, collect_sightings, frames_at
from pipeline.video.frame_rate import measured_rate_hz
from pipeline.video.timeline import frames_in


def hanging_cameras(turns_deg: Mapping[str, float]) -> Iterator[Finding]:
    """Say which cameras hang turned.

    ``turns_deg`` are the counterclockwise turns that brought the pictures upright, by camera, from 0 to 360 degrees.
    """
    for name, turn_deg in turns_deg.items():
        if turn_deg:
            way = "counterclockwise" if turn_deg < 180.0 else "clockwise"
            by = f"{min(turn_deg, 360.0 - turn_deg):.0f} degrees {way}"
            how = "upside down" if turn_deg == 180.0 else "turned"
            turned = "180 degrees" if turn_deg == 180.0 else by
            message = (
                f"The camera hangs {how}: its pictures are turned upright, by {turned}, before people are detected."
            )
            yield Finding(CAMERA_HANGS_TURNED, message, name, "info", evidence={"turn_deg": turn_deg})


# Parts of a long take, and the duration of each: enough to measure offsets and the drift from one end to the other.
_NUM_PARTS, _PART_S = 3, 20.0
# Comparisons of two bodies in a second that take some seconds together, ten times as many if cameras are late; and the
# least time that tells anything.
_MAX_COMPARISONS, _SHORTEST_S = 20_000.0, 4.0


DetectionsNear = Callable[[Sequence[range]], Sequence[DetectionsByCamera]]
"""Function that gives detections of the ranges that have some of given output frames."""


def check_clocks(session: Session, near: DetectionsNear, joints: JointSet, parts: Sequence[range]) -> Iterator[Finding]:
    """Find cameras whose declared times are wrong by more than half a frame, wherever the session's frames are cut.

    The session is whole, on its declared clocks. ``near`` gives the bodies of the ranges that have some of given output
    frames; ``parts`` are the wanted output frames.
    """
    spans = _spans(parts, session.timebase.frame_rate_hz)
    ranges = near(spans)
    length_s = sum(map(len, spans)) / session.timebase.frame_rate_hz
    detections = _bodies(session.times, session.timebase, joints, spans, ranges)
    share = _affordable(session.times, detections, length_s)
    if share * length_s < _SHORTEST_S and share < 1.0:
        message = "The declared times of the cameras were not compared: there are too many people for a check."
        yield Finding(CLOCKS_UNCHECKED, message, None, "info", "Measure the clocks by the people (sync: auto).")
        return
    if share < 1.0:
        spans = [_middle(span, share) for span in spans]
        detections = _bodies(session.times, session.timebase, joints, spans, [detections])
    for offset in remaining_offsets(session.cameras, session.times, detections, joints):
        if offset.is_wrong:
            yield _finding(offset)


def _bodies(
    times: Mapping[str, FrameTimes],
    timebase: Timebase,
    joints: JointSet,
    spans: Sequence[range],
    ranges: Sequence[DetectionsByCamera],
) -> dict[str, Detections]:
    half_s = 0.5 / timebase.frame_rate_hz
    ends_s = [(timebase.time_s(span[0]) - half_s, timebase.time_s(span[-1]) + half_s) for span in spans]
    chunks = [
        bodies.within(frames_in(times[name], *ends))
        for ends in ends_s
        for part in ranges
        for name, bodies in part.items()
        if isinstance(bodies, Detections)
    ]
    return concatenate(chunks, list(times), len(joints.names))


def _affordable(times: Mapping[str, FrameTimes], detections: Mapping[str, Detections], length_s: float) -> float:
    """Share of a length that takes some seconds: each body is compared with all bodies of the camera's partners."""
    people = [
        len(bodies.frame) / max(1.0, length_s * measured_rate_hz(times[name].time_s))
        for name, bodies in detections.items()
    ]
    products = [first * second for first, second in itertools.combinations(people, 2)]
    comparisons = length_s * float(np.mean(products)) * min(len(products), MAX_PAIRS * len(people))
    return min(1.0, _MAX_COMPARISONS / max(comparisons, 1e-9))


def _middle(span: range, share: float) -> range:
    length = max(1, round(share * len(span)))
    start = span.start + (len(span) - length) // 2
    return range(start, start + length)


def _finding(offset: RemainingOffset) -> Finding:
    message = (
        f"The camera's frames were taken {1000 * abs(offset.late_s):.0f} ms "
        f"{'later' if offset.late_s > 0 else 'earlier'} than declared, {abs(offset.frames):.1f} frames "
        f"(+-{1000 * offset.sigma_s:.1f} ms), compared with the other cameras."
    )
    hint = f"Synchronise by the people (sync: auto), or add {offset.late_s:+.3f} s to the offset of this camera."
    evidence = {"late_s": offset.late_s, "sigma_s": offset.sigma_s, "late_frames": offset.frames}
    return Finding(CLOCKS_DISAGREE, message, offset.camera, "warning", hint, evidence)


def _spans(parts: Sequence[range], frame_rate_hz: float) -> list[range]:
    """Frames to look at: all of a short take, else the middles of equal parts of it, without pauses."""
    frames = np.concatenate([np.arange(part.start, part.stop) for part in parts]) if parts else np.empty(0, np.int64)
    length = round(_PART_S * frame_rate_hz)
    if len(frames) <= _NUM_PARTS * length:
        return list(parts)
    middles = [len(frames) * (2 * k + 1) // (2 * _NUM_PARTS) for k in range(_NUM_PARTS)]
    chosen = [frames[middle - length // 2 : middle - length // 2 + length] for middle in middles]
    pieces = [piece for middle in chosen for piece in np.split(middle, np.flatnonzero(np.diff(middle) != 1) + 1)]
    return [range(int(piece[0]), int(piece[-1]) + 1) for piece in pieces]


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
    """Add the findings about declared times to a check, unless cameras are wrong or no person is located.

    Arguments are the same as for ``check_detections``; the detections are whole bodies.
    """
    if has_error(check.findings) or not check.num_located:
        return check
    return replace(check, findings=(*check.findings, *check_clocks(session, near, joints, parts)))


def check_bodies(
    session: Session, detections: Mapping[str, Detections], joints: JointSet, parts: Sequence[range]
) -> SessionCheck:
    """Check a session by the people at a few instants, with the detections at least of these instants.

    Takes of animals alone have nothing to compare.
    """
    instants = choose_instants(parts)
    time_s = [session.timebase.time_s(instant) for instant in instants]
    frames = frames_at_instants(session.times, session.timebase, parts)
    sightings = collect_sightings(session.cameras, detections, frames, joints, time_s)
    people = {camera.name: sightings.num_people(number) for number, camera in enumerate(session.cameras)}
    has_animals = isinstance(session, KeypointSession) and any(
        len(rows.frame) for rows in session.own.of_animals.values()
    )
    if has_animals and not any(people.values()):
        return SessionCheck((), people, len(instants))
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
    # Keypoints have none, and their job need not load what decodes the networks' outputs.
    from pipeline.detection.decoders.fields import ImageFields  # noqa: PLC0415
    from pipeline.detection.decoders.grouping import group  # noqa: PLC0415

    bodies = []
    for frame in wanted:
        for row in np.flatnonzero(fields.frame == frame):
            at = slice(*np.searchsorted(fields.peak_row, [row, row + 1]))
            peaks = fields.peak_joint[at], fields.peak_px[at], fields.peak_score[at]
            image = ImageFields(*peaks, fields.fields[row], fields.grid)
            bodies.append((frame, group(image, fields.limbs, len(joints.names))))
    return bodies
