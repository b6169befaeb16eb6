"""Places of a take to look at, worst first: the probable fault, the person and the frames.

- *error*: a joint is far from its observations, compared with the take.
- *identity*: the person may be another one from here on, or vanishes.
- *sides*: left and right change places from one frame to the next.
- *few_views*: fewer than two cameras see the person, or a wrist or an ankle, for a while.
- *acceleration*: a joint accelerates far more than people's joints do.
- Codes of findings: a person or a camera is doubtful in the whole take.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.findings import Finding
from pipeline.core.joints import JointSet
from pipeline.core.options.edits import CAMERA_KINDS, PERSON_KINDS, ConcernKind
from pipeline.export.quality.views import PersonViews, without_fingers
from pipeline.motion.skeleton.feet.floor import find_runs
from pipeline.motion.skeleton.fitting.positions import usual_step_m

MAX_CONCERNS = 50
"""Largest number of places."""

# Error, as a multiple of the take's median and in pixels, from which on a joint is off; smoothing over frames.
_ERROR_RATIO, _ERROR_PX, _SMOOTH_S = 6.0, 8.0, 0.12
# Confidence below which a person may be another one; time shown around such a moment.
_UNCERTAIN, _AROUND_S = 0.9, 0.25
# Way in metres by which a limb's joints are nearer to the other side's joints a frame before; longest exchange.
_EXCHANGED_M, _LONGEST_S = 0.12, 2.0
# Shortest time with fewer than two cameras, and time at which the score is full.
_UNSEEN_S, _FULL_S = 0.3, 2.0
# Acceleration as a multiple of the usual one from which on it is sudden.
_SUDDEN = 12.0
# Score of what is doubtful in the whole take.
_WHOLE = 0.6
# Places of a person and kind that are so near are one.
_NEAR_S = 0.3
_SIDED = {"arms": ("shoulder", "elbow", "wrist"), "legs": ("hip", "knee", "ankle")}
_ENDS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")


class Concern(NamedTuple):
    """Frames of a person to look at."""

    kind: ConcernKind
    person: int | None  # Number of the track; ``None``: it is about a camera
    joint: str | None  # Joint that is concerned most; ``None``: the whole person
    start_frame: int
    stop_frame: int
    message: str  # Sentence that says what is probably wrong
    score: float  # From 0 to 1, which is worst
    camera: str | None = None


def find_concerns(
    take: Reconstruction, views: Sequence[PersonViews], findings: Sequence[Finding] = ()
) -> list[Concern]:
    """Rank the places of a take to look at, worst first, at most ``MAX_CONCERNS``.

    ``views`` are of the tracks, in their order; ``findings`` are of the whole take. Accepted places are left out.
    """
    errors_px = [np.asarray(_joint_error_px(figures)) for figures in views]
    known_px = np.concatenate([np.zeros(0), *(error_px[np.isfinite(error_px)] for error_px in errors_px)])
    usual_px = float(np.median(known_px)) if len(known_px) else np.nan
    found = list(_of_findings(take, findings))
    for number, (track, figures, error_px) in enumerate(zip(take.tracks, views, errors_px, strict=True)):
        body = without_fingers(track, take.joints)
        rate_hz = take.timebase.frame_rate_hz
        found += _joined(_off(body, error_px, usual_px, take.joints, rate_hz), rate_hz)
        found += _doubted(take, number, rate_hz)
        found += _joined(_exchanged(figures.located, take.joints, rate_hz), rate_hz)
        found += _joined(_unseen(body, figures.sees, take.joints, rate_hz), rate_hz)
        found += _joined(_sudden(body, take), rate_hz)
    left = [
        concern
        for concern in found
        if not take.accepts(concern.kind, concern.person or 0, range(concern.start_frame, concern.stop_frame))
    ]
    return sorted(left, key=lambda concern: (-concern.score, concern.start_frame, concern.person or 0))[:MAX_CONCERNS]


def _of_findings(take: Reconstruction, findings: Sequence[Finding]) -> Iterator[Concern]:
    """Places of findings about a person or a camera: all frames of the person, or of the take."""
    frames = {track.track_id: (track.start_frame, track.start_frame + track.num_frames) for track in take.tracks}
    for finding in findings:
        for kind in PERSON_KINDS:
            if finding.code == kind:
                people = finding.evidence.get("people") or finding.evidence.get("limbs", ())
                for person in dict.fromkeys(entry["person"] for entry in people):
                    yield Concern(kind, person, None, *frames[person], finding.message, _WHOLE)
        for of_camera in CAMERA_KINDS:
            if finding.code == of_camera:
                for camera in (finding.camera,) if finding.camera else finding.evidence.get("cameras", ()):
                    yield Concern(of_camera, None, None, 0, take.timebase.num_frames, finding.message, _WHOLE, camera)


def _joint_error_px(figures: PersonViews) -> Float[np.ndarray, "frames joints"]:
    """Mean error of each joint of the body over the cameras."""
    error_px = figures.error_px[:, :, : figures.located.source.shape[1]]
    is_known = np.isfinite(error_px)
    return np.asarray(np.where(is_known, error_px, 0.0).sum(1) / np.where(is_known.any(1), is_known.sum(1), np.nan))


def _off(
    track: Track3D, error_px: Float[np.ndarray, "frames joints"], usual_px: float, joints: JointSet, rate_hz: float
) -> Iterator[Concern]:
    shortest = max(2, round(_SMOOTH_S * rate_hz))
    is_off = np.nan_to_num(error_px) > max(_ERROR_RATIO * usual_px, _ERROR_PX)
    for joint in np.flatnonzero(is_off.any(0)).tolist():
        for start, stop in find_runs(is_off[:, joint]):
            worst_px = float(error_px[start:stop, joint].max())
            if stop - start >= shortest:
                name = joints.names[joint]
                message = f"The {_spoken(name)} is up to {worst_px:.0f} px from where cameras see it."
                yield _concern("error", track, name, (start, stop), message, worst_px / usual_px / (8 * _ERROR_RATIO))


def _doubted(take: Reconstruction, number: int, rate_hz: float) -> Iterator[Concern]:
    track, around = take.tracks[number], max(1, round(_AROUND_S * rate_hz))
    for doubt in take.doubts[number] if take.doubts else ():
        if doubt.confidence < _UNCERTAIN:
            row = doubt.frame - track.start_frame
            message = f"The person may be another one from frame {doubt.frame} on."
            yield _concern("identity", track, None, (row - around, row + around), message, 1.2 - doubt.confidence)
    for loss in take.losses:
        if loss.track_id == track.track_id and loss.kind == "vanished":
            rows = loss.start_frame - track.start_frame, loss.stop_frame - track.start_frame
            seconds = (rows[1] - rows[0]) / rate_hz
            message = f"The person is lost for {seconds:.1f} s, where cameras view the place."
            yield _concern("identity", track, None, rows, message, 0.3 + 0.7 * seconds / _FULL_S)


def _exchanged(located: Track3D, joints: JointSet, rate_hz: float) -> Iterator[Concern]:
    for limb, kinds in _SIDED.items():
        sides = [[f"{side}_{kind}" for kind in kinds] for side in ("left", "right")]
        if not {*sides[0], *sides[1]} <= set(joints.names):
            continue
        left_m, right_m = (located.xyz_m[:, joints.indices(tuple(names))] for names in sides)
        kept_m, other_m = (
            np.linalg.norm(left_m[1:] - first_m[:-1], axis=-1) + np.linalg.norm(right_m[1:] - second_m[:-1], axis=-1)
            for first_m, second_m in ((left_m, right_m), (right_m, left_m))
        )
        flips = np.flatnonzero((np.nan_to_num(kept_m - other_m) > _EXCHANGED_M).sum(1) >= 2) + 1
        row = 0
        while row < len(flips):
            start = int(flips[row])
            is_pair = row + 1 < len(flips) and flips[row + 1] - start <= _LONGEST_S * rate_hz
            stop = int(flips[row + 1]) if is_pair else start + 1
            message = f"Left and right {limb} are probably exchanged."
            yield _concern("sides", located, sides[0][-1], (start, stop), message, 0.95)
            row += 2 if is_pair else 1


def _unseen(
    track: Track3D, sees: Bool[np.ndarray, "frames cameras"], joints: JointSet, rate_hz: float
) -> Iterator[Concern]:
    is_alone = (sees.sum(1) < 2) & (sees.shape[1] > 0)  # 3D points have no cameras
    ends: list[tuple[str | None, np.ndarray, float]] = [(None, is_alone, 0.7)]
    for name in _ENDS:
        if name in joints.names:
            is_unseen = ~is_alone & (track.source[:, joints.index(name)] != Source.MEASURED)
            ends.append((name, is_unseen, 0.5))
    for end, is_unseen, most in ends:
        for start, stop in find_runs(is_unseen):
            seconds = (stop - start) / rate_hz
            if seconds >= _UNSEEN_S:
                subject = "person" if end is None else _spoken(end)
                message = f"Fewer than two cameras see the {subject} for {seconds:.1f} s."
                yield _concern("few_views", track, end, (start, stop), message, most * min(seconds / _FULL_S, 1.0))


def _sudden(track: Track3D, take: Reconstruction) -> Iterator[Concern]:
    rate_hz, names = take.timebase.frame_rate_hz, take.joints.names[: track.source.shape[1]]
    usual_m = usual_step_m(take.joints, take.timebase)[: len(names)]
    ratio = np.nan_to_num(np.linalg.norm(np.diff(track.xyz_m, n=2, axis=0), axis=-1)) / usual_m
    for start, stop in find_runs((ratio > _SUDDEN).any(1)):
        joint = int(ratio[start:stop].max(0).argmax())
        worst = float(ratio[start:stop, joint].max())
        acceleration = worst * float(usual_m[joint]) * rate_hz**2
        message = f"The {_spoken(names[joint])} accelerates by {acceleration:.0f} m/s²."
        yield _concern("acceleration", track, names[joint], (start, stop + 2), message, worst / (6 * _SUDDEN))


def _concern(
    kind: ConcernKind, track: Track3D, joint: str | None, rows: tuple[int, int], message: str, score: float
) -> Concern:
    start, stop = max(rows[0], 0) + track.start_frame, rows[1] + track.start_frame
    return Concern(kind, track.track_id, joint, start, stop, message, round(float(np.clip(score, 0.0, 1.0)), 3))


def _joined(concerns: Iterator[Concern], rate_hz: float) -> list[Concern]:
    """Places of a person and kind that are near each other as one, with the sentence of the worst."""
    joined: list[Concern] = []
    for concern in sorted(concerns, key=lambda concern: concern.start_frame):
        last = joined[-1] if joined else None
        if last is None or concern.start_frame > last.stop_frame + _NEAR_S * rate_hz:
            joined.append(concern)
            continue
        worst = max(last, concern, key=lambda concern: concern.score)
        joined[-1] = worst._replace(start_frame=last.start_frame, stop_frame=max(last.stop_frame, concern.stop_frame))
    return joined


def _spoken(joint: str) -> str:
    return joint.replace("_", " ")
