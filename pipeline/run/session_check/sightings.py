"""People seen by the cameras at a few instants of a session, and the agreement of two cameras about them.

Agreement is measured by epipolar distances relative to the size of the people. The measure has no unit, and needs
neither the scale of the world nor an association of people.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.joints import FINGER_JOINTS, JointSet
from pipeline.geometry.epipolar import distance_to_line_px
from pipeline.geometry.undistortion import undistort_px

NUM_INSTANTS = 12
"""Number of instants at which people are looked at: enough for medians, few enough for a network on a processor."""

# Within less time people hardly move, and what a detector gets wrong it gets wrong again.
_INDEPENDENT_S = 0.25
# Joints with lower scores are guesses, and fewer joints are no body.
_MIN_SCORE, _MIN_JOINTS = 0.3, 6

Points = Float[np.ndarray, "_ _ 2"]
"""Joints of people, (people, joints, 2), in pixels; NaN where a joint was not seen."""


@dataclass(frozen=True, slots=True)
class SimultaneousPeople:
    """People at the same instants in all cameras."""

    # Joints of the people by camera, then by instant; ``None`` where the camera took no frame. Pixels of the picture as
    # the camera took it.
    points_px: tuple[tuple[Points | None, ...], ...]
    joints: JointSet  # Joints of the people, without fingers
    time_s: tuple[float, ...]  # Times of the instants, ascending

    def num_people(self, camera: int) -> int:
        """Number of people seen by a camera, at all instants together."""
        return sum(len(people) for people in self.points_px[camera] if people is not None)

    def moved(self, camera: int, move: Callable[[Points], Points]) -> "SimultaneousPeople":
        """Sightings after the points of a camera were moved."""
        own = tuple(None if people is None else move(people) for people in self.points_px[camera])
        return replace(self, points_px=(*self.points_px[:camera], own, *self.points_px[camera + 1 :]))

    def num_independent(self, instants: Iterable[int]) -> int:
        """Number of instants, given by their places, that tell something new: those a quarter of a second apart."""
        number, last_s = 0, -np.inf
        for instant in sorted(instants):
            if self.time_s[instant] - last_s >= _INDEPENDENT_S:
                number, last_s = number + 1, self.time_s[instant]
        return number


def choose_instants(stretches: Sequence[range], number: int = NUM_INSTANTS) -> list[int]:
    """Output frames in the middle of equal parts of the recorded frames, ascending.

    They do not depend on how the frames are cut into ranges.
    """
    total = sum(map(len, stretches))
    places = sorted({int((part + 0.5) * total / number) for part in range(number)}) if total else []
    frames: list[int] = []
    before = 0
    for stretch in stretches:
        frames += [stretch[place - before] for place in places if before <= place < before + len(stretch)]
        before += len(stretch)
    return frames


def frames_at(times: FrameTimes, timebase: Timebase, instants: Sequence[int]) -> list[int | None]:
    """Frames of a camera that were taken at output frames; ``None`` where the camera took none."""
    frames: list[int | None] = []
    for instant in instants:
        time_s = timebase.time_s(instant)
        number = int(np.argmin(np.abs(times.time_s - time_s))) if len(times.time_s) else 0
        is_near = len(times.time_s) and abs(times.time_s[number] - time_s) <= 1.0 / timebase.frame_rate_hz
        frames.append(number if is_near else None)
    return frames


def collect_sightings(
    cameras: Sequence[Camera],
    detections: Mapping[str, Detections],
    frames: Mapping[str, Sequence[int | None]],
    joints: JointSet,
    time_s: Sequence[float],
) -> SimultaneousPeople:
    """Select the people in frames of each camera.

    Detections of other frames, and fingers, are left out; ``frames`` are the frames of each camera at the instants, see
    ``frames_at``, and ``time_s`` are the times of the instants.
    """
    kept = [number for number, name in enumerate(joints.names) if name not in FINGER_JOINTS]
    names = tuple(joints.names[number] for number in kept)
    bones = tuple(bone for bone in joints.bones if FINGER_JOINTS.isdisjoint(bone))
    return SimultaneousPeople(
        tuple(
            tuple(
                None if frame is None else _people(detections[camera.name], frame, kept)
                for frame in frames[camera.name]
            )
            for camera in cameras
        ),
        JointSet(names, bones),
        tuple(time_s),
    )


def _people(detections: Detections, frame: int, kept: Sequence[int]) -> Points:
    rows = np.flatnonzero(detections.frame == frame)
    points_px = detections.keypoints_px[rows][:, kept]
    points_px = np.where(detections.score[rows][:, kept, None] >= _MIN_SCORE, points_px, np.nan)
    return np.asarray(points_px[np.isfinite(points_px[..., 0]).sum(-1) >= _MIN_JOINTS], np.float64)


def ideal_px(camera: Camera, of_camera: Sequence[Points | None]) -> list[Points | None]:
    """Undistort the people of a camera at all instants."""
    return [people if people is None or not len(people) else undistort_px(camera, people) for people in of_camera]


FAR = 0.1
"""Distance, as a share of a person's extent in the picture, from which on a pair of bodies counts as not the same.

Detectors are off by 1 to 2 % of it. The next person is a body's width, a quarter of it, away.
"""
SURE = 0.015
"""Distance within which most pairs of bodies of one person are, and of different people as many as chance has it."""
# Distance within which a pair of bodies counts as exactly the same.
_EXACT = 0.03
# Fewer common joints are no evidence.
MIN_JOINTS = 5


@dataclass(frozen=True, slots=True)
class PeopleAgreement:
    """PeopleAgreement of two cameras about people."""

    disagreement: float = np.nan  # Mean distance of pairs of bodies: 0 if they agree, 1 if they do not; NaN without any
    exact_share: float = np.nan  # Share of these pairs that are exactly the same; NaN without any
    near_share: float = np.nan  # Share of these pairs that may be the same; NaN without any
    sure_share: float = np.nan  # Share of these pairs that are as near as one person's are; NaN without any
    num_pairs: int = 0  # Number of pairs of bodies at all instants together
    instants: frozenset[int] = frozenset()  # Places of the instants with a pair


def compare(
    fundamental: Float[np.ndarray, "3 3"], left: Sequence[Points | None], right: Sequence[Points | None]
) -> PeopleAgreement:
    """Compare the people seen by two cameras at the same instants by their epipolar distances.

    At each instant the people are paired so that the sum of their distances is least. The distance of a pair is the
    median over its joints, as a share of the people's extents in the pictures; above 0.1 it counts as 0.1, and the mean
    is divided by 0.1. A pair is exactly the same below 0.03. The people are undistorted, and
    ``x_left^T F x_right = 0``.
    """
    distances, instants = [np.empty(0)], []
    for instant, (first, second) in enumerate(zip(left, right, strict=True)):
        if first is not None and second is not None and len(first) and len(second):
            distance = body_distances(fundamental, first, second)
            # Beyond ``FAR`` all distances are alike: a person seen by one camera takes no body from another pair.
            distances.append(distance[linear_sum_assignment(np.minimum(distance, FAR))])
            instants.append(instant)
    if not instants:
        return PeopleAgreement()
    known = np.concatenate(distances)
    mean = float(np.mean(np.minimum(known, FAR))) / FAR
    exact, near, sure = (float(np.mean(known < limit)) for limit in (_EXACT, FAR, SURE))
    return PeopleAgreement(mean, exact, near, sure, len(known), frozenset(instants))


def body_distances(
    fundamental: Float[np.ndarray, "3 3"], left: Points, right: Points
) -> Float[np.ndarray, "left right"]:
    """Distances of all pairs of people; 1 for people with too few common joints."""
    of_left = np.concatenate([left, np.ones_like(left[..., :1])], axis=-1)
    of_right = np.concatenate([right, np.ones_like(right[..., :1])], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        both_px = np.broadcast_arrays(left[:, None], right[None])
        lines = np.broadcast_arrays((of_right @ fundamental.T)[None], (of_left @ fundamental)[:, None])
        in_left = distance_to_line_px(both_px[0], lines[0]) / extents_px(left)[:, None, None]
        in_right = distance_to_line_px(both_px[1], lines[1]) / extents_px(right)[None, :, None]
    shares = (in_left + in_right) / 2
    is_known = np.isfinite(shares)
    # The median of the known joints: unknown ones are sorted to the end.
    ordered = np.sort(np.where(is_known, shares, np.inf), axis=-1)
    count = is_known.sum(-1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    return np.where(count >= MIN_JOINTS, np.minimum(middle, 1.0), 1.0)


def extents_px(people: Points) -> Float[np.ndarray, " people"]:
    """Diagonal of the box around each person's joints, at least a pixel."""
    low = np.where(np.isfinite(people), people, np.inf).min(1)
    high = np.where(np.isfinite(people), people, -np.inf).max(1)
    return np.maximum(np.hypot(*(high - low).T), 1.0)
