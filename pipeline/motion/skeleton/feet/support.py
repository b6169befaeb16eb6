"""Support of the body: what tells feet that carry it from feet that hang, ride along, or stand on a moving belt."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from pipeline.core.data.people import Track3D
from pipeline.core.joints import SIDES, JointSet
from pipeline.motion.skeleton.feet.floor import find_runs

# Height of the hips above a foot, as a share of the leg, from which on the foot carries an upright body: people who
# sit, squat or crawl have half of it.
_UPRIGHT_SHARE = 0.6
# Least height of the knee above the ankle, as a share of the shin, of a shin that stands.
_STEEP = 0.5
# Smoothing of velocities, and of products of velocities. A foot rides along with hips that are faster than this, if its
# velocity along theirs has at least this share of it, and stays where it is with less than the last share.
_SMOOTH_S, _AROUND_S, _MOVING_M_S, _RIDING, _STAYING = 0.06, 0.15, 0.06, 0.7, 0.5
# Belt: least speed; height up to which feet are low; width of the velocities of standing feet, which is more at a
# higher speed; least way of a stance; least share of the low feet that stand on the belt, also as a multiple of those
# at rest; least way of the belt, and largest speed of the body as a share of its speed.
_BELT_M_S, _LOW_M, _SPREAD_M_S, _SPREAD_SHARE, _STANCE_M = 0.15, 0.04, 0.1, 0.08, 0.15
_BELT_SHARE, _BELT_RATIO, _BELT_WAY_M, _STAYS = 0.2, 2.0, 1.0, 0.3
_ITERATIONS = 10
# Shares of a stance between which the ankle goes with the ground, and of the time in which a heel or a toe stands
# between which it does.
_FLAT_SHARES, _STILL_SHARES = (0.2, 0.6), (0.1, 0.9)


OVERHEAD_M = 0.1
"""Height of both hands above the shoulders from which on a body may hang."""


@dataclass(frozen=True, slots=True, eq=False)
class FootMarks:
    """Heels and toes, each of which stands still on the ground for a part of each stance."""

    xyz_m: Float[np.ndarray, "frames marks 3"]  # Positions, finite wherever they are known and between
    known: Bool[np.ndarray, "frames marks"]  # Frames in which they were located

    @classmethod
    def none(cls, num_frames: int) -> "FootMarks":
        """No heel and no toe."""
        return cls(np.empty((num_frames, 0, 3)), np.empty((num_frames, 0), bool))


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Frames of a person in which feet (left, right) may stand, and what they stand on."""

    # Velocity of a foot along the hips' velocity, times the hips' speed, and its square: on the ground
    along_m2_s2: Float[np.ndarray, "frames 2"]
    squared_m2_s2: Float[np.ndarray, "frames 1"]
    shin_stands: Bool[
        np.ndarray, "frames 2"
    ]  # True if the knee is above the foot: shins lie of people who kneel or crawl
    # True if the foot carries an upright body that does not hang by its hands: the floor is under these feet
    carries: Bool[np.ndarray, "frames 2"]
    # Feet that bear nothing: legs are stretched below hands overhead, and the foot does not stay where it is while the
    # hips move
    hangs: Bool[np.ndarray, "frames 2"]
    ground_m: Float[np.ndarray, "frames 3"]  # Way of the ground since the first frame: of a belt, else zeros

    def rides(self, rows: slice, foot: int) -> bool:
        """Tell if a foot moves along with the hips in the middle of some frames, and so does not stand."""
        middle = middle_rows(rows)
        return bool(_is_riding(self.along_m2_s2[middle, foot].mean(), self.squared_m2_s2[middle].mean()))


def find_support(
    track: Track3D,
    joints: JointSet,
    ankles_m: Float[np.ndarray, "frames 2 3"],
    known: Bool[np.ndarray, "frames 2"],
    marks: FootMarks,
    frame_rate_hz: float,
) -> Support:
    """Find out what carries a person; ``known`` are the frames in which the ankles were located."""
    hips_m, shoulders_m, wrists_m, knees_m = (
        np.stack([_points_m(track, joints, f"{side}_{name}") for side in SIDES], axis=1)
        for name in ("hip", "shoulder", "wrist", "knee")
    )
    middle_m = hips_m.mean(1)
    ground_m = belt_m(ankles_m, known, middle_m, frame_rate_hz, marks)
    of_ankles, of_hips = (
        _velocity_m_s(ankles_m - ground_m[:, None], frame_rate_hz),
        _velocity_m_s(middle_m - ground_m, frame_rate_hz)[:, None],
    )
    along, squared = np.nan_to_num((of_ankles * of_hips).sum(-1)), np.nan_to_num((of_hips**2).sum(-1))
    around = _AROUND_S * frame_rate_hz
    common = [gaussian_filter1d(values, around, axis=0, mode="nearest") for values in (along, squared)]
    rides, stays = _is_riding(*common), _is_staying(*common)
    leg_m = np.linalg.norm(hips_m - knees_m, axis=-1) + np.linalg.norm(knees_m - ankles_m, axis=-1)
    usual_m = float(np.median(leg_m[np.isfinite(leg_m)])) if np.isfinite(leg_m).any() else np.inf
    # Comparisons with NaN are false.
    is_low = middle_m[:, None, 2] - ankles_m[..., 2] < _UPRIGHT_SHARE * usual_m
    hangs = (wrists_m[..., 2] - shoulders_m.mean(1)[:, None, 2] > OVERHEAD_M).all(-1)
    shin_m = knees_m - ankles_m
    shin_lies = shin_m[..., 2] < _STEEP * np.linalg.norm(shin_m, axis=-1)
    carries = known & ~is_low & ~hangs[:, None] & ~rides
    bears_nothing = hangs[:, None] & ~is_low & ~stays
    return Support(along, squared, ~shin_lies, np.asarray(carries), np.asarray(bears_nothing), ground_m)


def middle_rows(rows: slice) -> slice:
    """Some frames without the first and the last fifth, in which a foot comes and goes."""
    margin = (rows.stop - rows.start) // 5
    return slice(rows.start + margin, rows.stop - margin)


def _points_m(track: Track3D, joints: JointSet, name: str) -> Float[np.ndarray, "frames 3"]:
    if name not in joints.names:
        return np.full((track.num_frames, 3), np.nan)
    return np.asarray(track.xyz_m[:, joints.index(name)])


def _velocity_m_s(
    points_m: Float[np.ndarray, "frames *points 3"], frame_rate_hz: float
) -> Float[np.ndarray, "frames *points 3"]:
    """Velocity of points in metres a second, smoothed; NaN near frames in which they are unknown."""
    if len(points_m) < 2:
        return np.zeros_like(points_m)
    smooth_m = gaussian_filter1d(points_m, _SMOOTH_S * frame_rate_hz, axis=0, mode="nearest")
    return np.asarray(np.gradient(smooth_m, axis=0) * frame_rate_hz)


def _is_riding(along: Any, squared: Any) -> Any:
    """Feet that move as the hips do: of people who hang, swing or are carried."""
    return (squared > _MOVING_M_S**2) & (along > _RIDING * squared)


def _is_staying(along: Any, squared: Any) -> Any:
    """Feet that stay where they are while the hips move: of people who stand or climb."""
    return (squared > _MOVING_M_S**2) & (along < _STAYING * squared)


def belt_m(
    ankles_m: Float[np.ndarray, "frames 2 3"],
    known: Bool[np.ndarray, "frames 2"],
    hips_m: Float[np.ndarray, "frames 3"],
    frame_rate_hz: float,
    marks: FootMarks | None = None,
) -> Float[np.ndarray, "frames 3"]:
    """Way of a treadmill's belt since the first frame, zeros if there is none.

    Feet that stand on a belt have its velocity, while the body stays where it is. The ankles tell that there is a belt;
    its velocity is the velocity of heels and toes while each of them stands, which is longer than the foot is flat.
    Without ``marks`` it is the velocity of the ankles of flat feet.
    """
    unmoved_m = np.zeros((len(ankles_m), 3))
    place_m = hips_m[np.isfinite(hips_m).all(-1)]
    if not known.any() or len(place_m) < 2:
        return unmoved_m
    height_m = ankles_m[..., 2]
    velocity_m_s = _velocity_m_s(ankles_m, frame_rate_hz)
    low = known & (height_m < np.quantile(height_m[known], 0.1) + _LOW_M) & np.isfinite(velocity_m_s).all(-1)
    if not low.any():
        return unmoved_m
    of_low = velocity_m_s[low]
    belt_m_s = np.median(of_low, axis=0) * [1.0, 1.0, 0.0]
    for share in (*[1.0] * _ITERATIONS, *[1.0 / 3.0] * _ITERATIONS):
        weight = np.exp(-((of_low - belt_m_s) ** 2).sum(-1) / (2 * (share * _spread_m_s(belt_m_s)) ** 2))
        belt_m_s = (of_low * weight[:, None]).sum(0) / max(float(weight.sum()), 1e-9) * [1.0, 1.0, 0.0]
    speed_m_s = float(np.linalg.norm(belt_m_s))
    duration_s = len(ankles_m) / frame_rate_hz
    stands = low & (np.linalg.norm(velocity_m_s - belt_m_s, axis=-1) < _spread_m_s(belt_m_s))
    shortest = _STANCE_M / max(speed_m_s, 1e-9) * frame_rate_hz
    runs = [
        (foot, start, stop)
        for foot in range(2)
        for start, stop in find_runs(stands[:, foot])
        if stop - start >= shortest
    ]
    on_belt = sum(stop - start for _, start, stop in runs)
    at_rest = np.count_nonzero(np.linalg.norm(of_low, axis=-1) < _SPREAD_M_S)
    goes_m = float(np.linalg.norm((place_m[-1] - place_m[0])[:2]))
    if (
        speed_m_s < _BELT_M_S
        or speed_m_s * duration_s < _BELT_WAY_M
        or on_belt < max(_BELT_SHARE * len(of_low), _BELT_RATIO * at_rest)
        or goes_m > _STAYS * speed_m_s * duration_s
    ):
        return unmoved_m
    paths_m = [] if marks is None else _still_m(marks, belt_m_s, shortest, frame_rate_hz)
    if len(paths_m) < len(runs):  # too little was seen of heels and toes
        paths_m = [ankles_m[_middle(start, stop, _FLAT_SHARES), foot] for foot, start, stop in runs]
    belt_m_s = _shared_velocity_m_s(paths_m, frame_rate_hz)
    return np.asarray(belt_m_s * (np.arange(len(ankles_m)) / frame_rate_hz)[:, None])


def _middle(start: int, stop: int, shares: tuple[float, float]) -> slice:
    """Frames of a stance between two shares of it: the point neither follows the landing nor the rise of the heel."""
    first, last = (start + share * (stop - start) for share in shares)
    return slice(int(np.ceil(first)), int(np.ceil(last)))


def _still_m(
    marks: FootMarks, belt_m_s: Float[np.ndarray, " 3"], shortest: float, frame_rate_hz: float
) -> list[Float[np.ndarray, "_ 3"]]:
    """Paths of heels and toes while they stand on a belt of about some velocity."""
    off_m_s = np.linalg.norm((_velocity_m_s(marks.xyz_m, frame_rate_hz) - belt_m_s)[..., :2], axis=-1)
    stands = marks.known & (off_m_s < _spread_m_s(belt_m_s))
    return [
        marks.xyz_m[_middle(start, stop, _STILL_SHARES), mark]
        for mark in range(stands.shape[1])
        for start, stop in find_runs(stands[:, mark])
        if stop - start >= shortest
    ]


def _shared_velocity_m_s(paths_m: Sequence[Float[np.ndarray, "_ 3"]], frame_rate_hz: float) -> Float[np.ndarray, " 3"]:
    """Level velocity that all paths share, by least squares with a place of its own for each.

    Single velocities would be of feet that still land or already rise, which are slower than the belt.
    """
    products, squares = np.zeros(3), 0.0
    for path_m in paths_m:
        time_s = np.arange(len(path_m)) / frame_rate_hz
        since_s = time_s - time_s.mean() if len(time_s) else time_s
        products += since_s @ path_m
        squares += float(since_s @ since_s)
    return np.asarray(products / max(squares, 1e-12) * [1.0, 1.0, 0.0])


def _spread_m_s(belt_m_s: Float[np.ndarray, " 3"]) -> float:
    """Width of the velocities of feet that stand on a belt."""
    return _SPREAD_M_S + _SPREAD_SHARE * float(np.linalg.norm(belt_m_s))
