"""Check of declared times: cameras whose clocks disagree, measured from people in motion in a minute of the take."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from pipeline.capture.session import Session
from pipeline.capture.synchronization.remaining import RemainingOffset, remaining_offsets
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections, DetectionsByCamera
from pipeline.core.findings import Finding
from pipeline.core.joints import JointSet
from pipeline.core.problems.findings import CLOCKS_DISAGREE
from pipeline.detection.chunk import concatenate
from pipeline.video.frame_rate import measured_rate_hz
from pipeline.video.timeline import frames_in

# Parts of a long take, and the duration of each: enough to measure offsets and the drift from one end to the other.
_NUM_PARTS, _PART_S = 3, 20.0
# Comparisons of two bodies in a second that take some ten seconds together, and the least that tells anything: crowds
# before many cameras are not checked.
_MAX_COMPARISONS, _SHORTEST_S = 2400.0, 4.0


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
    """Bodies of each camera in spans of output frames."""
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
    """Share of a length that can be looked at in some seconds: each body is compared with all of other cameras."""
    people = [
        len(bodies.frame) / max(1.0, length_s * measured_rate_hz(times[name].time_s))
        for name, bodies in detections.items()
    ]
    comparisons = length_s * sum(first * second for first, second in itertools.combinations(people, 2))
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
