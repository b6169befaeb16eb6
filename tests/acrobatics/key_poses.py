"""Key poses of acrobatics, and the reference motion between them.

A key pose names the angles that differ from standing, and the points that are planted in it. A point that is planted in
consecutive key poses stays in its place between them. So the places of hands, knees and feet follow from the poses: a
key pose is moved to where its planted points are already.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

from pipeline.core.joints import other_side
from tests.acrobatics import anatomy

# Random variation of angles in degrees, of angles of the pelvis, and of the time between two key poses.
_VARY_DEG, _VARY_PELVIS_DEG, _VARY_TIME = 5.0, 2.0, 0.15
_PELVIS = ("yaw", "pitch", "roll")
# Angles whose sign depends on the side of the body.
_SIDED = frozenset(("yaw", "roll", "spine_side", "spine_twist", "head_twist"))


@dataclass(frozen=True, slots=True)
class KeyPose:
    """Pose of an acrobat at an instant."""

    time_s: float
    # Angles of ``anatomy.ANGLE_NAMES`` in degrees, 0 for others; names of limbs without a side hold for both sides
    angles_deg: Mapping[str, float]
    planted: tuple[str, ...] = ()  # Points of ``anatomy.POINTS`` that stay in place
    lift_m: float = 0.0  # Height of the lowest point above the floor
    bar_m: float | None = None  # Height of a bar at which the planted points hang; ``None``: they are on the floor
    # Displacement of the hips from the key pose before, ahead and to the left, if no planted point is shared
    travel_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Planted:
    """Point that stays in place for a while."""

    point: str
    place_m: Float[np.ndarray, " 3"]
    start_s: float
    stop_s: float


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceMotion:
    """Motion through key poses, which planted points and the floor change slightly."""

    root_m: Float[np.ndarray, "times 3"]
    angles_rad: Float[np.ndarray, "times angles"]
    planted: tuple[Planted, ...] = field(default_factory=tuple)


def vary(keys: Sequence[KeyPose], rng: np.random.Generator) -> tuple[KeyPose, ...]:
    """Vary angles and times at random, and exchange left and right in half of the draws.

    Angles at their limits do not vary, so that knees that are bent fully remain so.
    """
    is_mirrored = rng.random() < 0.5
    tempo = float(rng.uniform(1 - _VARY_TIME, 1 + _VARY_TIME))
    own = dict(zip(anatomy.ANGLE_NAMES, rng.normal(0.0, 1.0, len(anatomy.ANGLE_NAMES)), strict=True))
    varied = []
    for key in keys:
        angles_deg = {}
        for name, angle_deg in _by_side(key.angles_deg).items():
            sigma_deg = _VARY_PELVIS_DEG if name in _PELVIS else _VARY_DEG
            lowest, highest = anatomy.ANGLE_LIMITS_DEG[name]
            room_deg = min(angle_deg - lowest, highest - angle_deg) / 2
            drawn = np.clip((own[name] + rng.normal()) / np.sqrt(2), -2, 2)
            angles_deg[name] = angle_deg + float(drawn) * min(sigma_deg, max(room_deg, 0.0))
        moved = replace(key, angles_deg=angles_deg, time_s=tempo * key.time_s)
        varied.append(_mirrored(moved) if is_mirrored else moved)
    return tuple(varied)


def _by_side(angles_deg: Mapping[str, float]) -> Mapping[str, float]:
    """All angles by full name; angles of limbs without a side are of both sides."""
    return {
        name: angles_deg.get(name, angles_deg.get(name.partition("_")[2], 0.0))
        if name.startswith(("left_", "right_"))
        else angles_deg.get(name, 0.0)
        for name in anatomy.ANGLE_NAMES
    }


def _mirrored(key: KeyPose) -> KeyPose:
    angles_deg = {other_side(name): -angle if name in _SIDED else angle for name, angle in key.angles_deg.items()}
    planted = tuple(other_side(name) for name in key.planted)
    return replace(key, angles_deg=angles_deg, planted=planted, travel_m=(key.travel_m[0], -key.travel_m[1]))


def reference_motion(
    keys: Sequence[KeyPose],
    body: anatomy.AcrobatBody,
    center_m: tuple[float, float],
    facing_rad: float,
    time_s: Float[np.ndarray, " times"],
) -> ReferenceMotion:
    """Lay out the motion through key poses; it stays in the first and in the last of them before and after.

    ``keys``: at least two key poses in order of time. ``center_m``, ``facing_rad``: middle of the way of the hips on
    the floor, and the heading of a pelvis that is not turned. ``time_s``: ascending times of the motion.
    """
    angles_rad = np.radians([[*_by_side(key.angles_deg).values()] for key in keys])
    angles_rad[:, anatomy.ANGLE_NAMES.index("yaw")] += facing_rad
    centred_m = anatomy.points_m(body, np.zeros((len(keys), 3)), angles_rad)
    root_m = np.zeros((len(keys), 3))
    ahead = np.array([np.cos(facing_rad), np.sin(facing_rad)])
    aside = np.array([-ahead[1], ahead[0]])
    runs: list[Planted] = []
    open_runs: dict[str, Planted] = {}
    for number, key in enumerate(keys):
        shared = [name for name in key.planted if name in open_runs]
        if number:
            root_m[number, :2] = root_m[number - 1, :2] + key.travel_m[0] * ahead + key.travel_m[1] * aside
        if shared:
            offsets_m = [open_runs[name].place_m - centred_m[number, anatomy.POINTS.index(name)] for name in shared]
            root_m[number, :2] = np.mean(offsets_m, axis=0)[:2]
        if key.bar_m is None:
            root_m[number, 2] = key.lift_m - (centred_m[number, :, 2] - anatomy.CLEARANCE_M).min()
        else:
            held_m = centred_m[number, [anatomy.POINTS.index(name) for name in key.planted], 2]
            root_m[number, 2] = key.bar_m - held_m.mean()
        still = {}
        for name in key.planted:
            place_m = root_m[number] + centred_m[number, anatomy.POINTS.index(name)]
            place_m[2] = anatomy.CLEARANCE_M[anatomy.POINTS.index(name)] if key.bar_m is None else key.bar_m
            begun = open_runs.pop(name, Planted(name, place_m, key.time_s, key.time_s))
            still[name] = replace(begun, stop_s=key.time_s)
        runs += open_runs.values()
        open_runs = still
    runs += [replace(run, stop_s=np.inf) for run in open_runs.values()]
    first_s = keys[0].time_s
    moved_m = np.append(center_m - (root_m.min(0) + root_m.max(0))[:2] / 2, 0.0)
    root_m += moved_m
    planted = [
        replace(run, place_m=run.place_m + moved_m, start_s=-np.inf if run.start_s == first_s else run.start_s)
        for run in runs
    ]
    key_s = np.array([key.time_s for key in keys])
    at_s = np.clip(time_s, key_s[0], key_s[-1])
    return ReferenceMotion(
        root_m=np.asarray(PchipInterpolator(key_s, root_m)(at_s)),
        angles_rad=np.asarray(PchipInterpolator(key_s, angles_rad)(at_s)),
        planted=tuple(planted),
    )
