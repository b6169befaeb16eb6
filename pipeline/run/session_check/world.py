"""Checks of the world by people: they are upright, of human size, on the floor, and have left where left is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Source, Track3D
from pipeline.core.findings import Finding, Severity
from pipeline.core.joints import JointSet
from pipeline.core.problems import finding_codes
from pipeline.export.quality import world_checks
from pipeline.export.quality.report import estimate_stature_m
from pipeline.geometry.camera import center_in_world
from pipeline.geometry.triangulation import solve_normal
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M
from pipeline.motion.skeleton.feet.support import OVERHEAD_M
from pipeline.run.session_check.consensus import LocatedPeople

# With fewer people, chance decides.
_MIN_POSES, _MIN_FACES = 6, 20
# Cameras with which each camera is paired.
_NUM_NEXT = 3
# No person is smaller or taller, whatever the error of the estimate: the unit is another one.
_POSSIBLE_M = (0.4, 3.0)
# Heights are less exact than a reconstruction's, which has its own check.
_MAX_FLOOR_M = 0.3
# Bodies at one place, and the least number of instants at which a body that never moves is there.
_SAME_PLACE_M, _MIN_INSTANTS_AT_PLACE = 0.04, 4
# Share of people who may hang from a bar, so that their feet tell of no floor.
_MAX_HANGING = 0.25
_ARMS = ("left_wrist", "right_wrist", "left_shoulder", "right_shoulder")
_ANKLES = ("left_ankle", "right_ankle")


def locate(
    cameras: Sequence[Camera], located: LocatedPeople
) -> tuple[Sequence[int], Float[np.ndarray, "poses joints 3"]]:
    """Locate people from pairs of cameras; a person seen by several pairs has several poses.

    Returns the place of the instant of each pose, and the poses: joints in metres, NaN where not both cameras see a
    joint. Of a person seen by many cameras, each camera is paired with the next three alone.
    """
    instants, poses = [np.empty(0, int)], [np.empty((0, *located.normal.shape[2:3], 3))]
    is_view = located.is_view
    for step in range(1, _NUM_NEXT + 1):
        for number, views in enumerate(map(np.flatnonzero, is_view)):
            first = np.arange(max(0, len(views) - step))
            pair = located.normal[number, views[first]] + located.normal[number, views[first + step]]
            is_common = np.isfinite(
                located.points_px[number, views[first]] + located.points_px[number, views[first + step]]
            )
            poses.append(np.where(is_common.all(-1)[..., None], solve_normal(pair), np.nan))
            instants.append(np.full(len(first), located.instant[number]))
    return np.concatenate(instants).tolist(), np.concatenate(poses)


def check_world(
    cameras: Sequence[Camera], poses_m: Float[np.ndarray, "poses joints 3"], joints: JointSet, is_certain: bool = True
) -> list[Finding]:
    """Check the world by located people. ``poses_m`` come from ``locate``.

    Nothing is an error unless ``is_certain``: the people were seen at enough instants.
    """
    if len(poses_m) < _MIN_POSES:
        return []
    known = np.isfinite(poses_m[..., 0])
    source = np.where(known, Source.MEASURED, Source.ABSENT)
    poses = Track3D(1, 0, poses_m, known.astype(np.float64), source, np.where(known, 0.0, np.nan), 2 * known)
    wrong = [*_check_upright(cameras, poses, joints), *_check_stature(poses, joints), *_check_sides(poses, joints)]
    if not is_certain:
        wrong = [replace(finding, severity="warning") for finding in wrong]
    # Heights mean nothing in another unit, or along another axis.
    return wrong or list(_check_heights(cameras, poses_m, joints))


def select_movers(
    instants: Sequence[int], poses_m: Float[np.ndarray, "poses joints 3"]
) -> Float[np.ndarray, "moving joints 3"]:
    """Poses of people who are not at one place at half of the instants, as pictures on walls are; all without any.

    ``instants`` and ``poses_m`` come from ``locate``.
    """
    is_located = np.isfinite(poses_m[..., 0]).any(-1)
    number, poses_m = np.asarray(instants, int)[is_located], poses_m[is_located]
    is_known = np.isfinite(poses_m[..., 0])
    middle_m = np.array([np.median(pose_m[known], axis=0) for pose_m, known in zip(poses_m, is_known, strict=True)])
    usual = max(_MIN_INSTANTS_AT_PLACE, len(np.unique(number)) / 2)
    near = cKDTree(middle_m).query_ball_point(middle_m, _SAME_PLACE_M) if len(middle_m) else []
    moves = np.array([len(np.unique(number[rows])) < usual for rows in near], bool)
    return poses_m[moves] if np.count_nonzero(moves) >= _MIN_POSES else poses_m


def _check_upright(cameras: Sequence[Camera], poses: Track3D, joints: JointSet) -> Iterator[Finding]:
    upwards = world_checks.feet_to_head_m(poses, joints)
    upwards = upwards[np.isfinite(upwards).all(-1)]
    if len(upwards) < _MIN_POSES:
        return
    lean_deg = float(np.median(np.degrees(np.arctan2(np.hypot(upwards[:, 0], upwards[:, 1]), upwards[:, 2]))))
    if (fault := world_checks.lean_fault(lean_deg, cameras)) is not None:
        severity: Severity = "error" if fault.is_agreed else "warning"
        evidence = {"lean_deg": lean_deg, "num_people": len(upwards)}
        yield Finding(fault.code, fault.message, None, severity, fault.hint, evidence)


def _check_stature(poses: Track3D, joints: JointSet) -> Iterator[Finding]:
    stature_m = estimate_stature_m(poses, joints)
    lowest_m, highest_m = world_checks.STATURE_RANGE_M
    if np.isfinite(stature_m) and not lowest_m <= stature_m <= highest_m:
        message = f"People are {stature_m:.3g} m tall: the unit of the calibration may not be the metre."
        evidence = {"stature_m": stature_m, "num_people": poses.num_frames}
        severity: Severity = "warning" if _POSSIBLE_M[0] <= stature_m <= _POSSIBLE_M[1] else "error"
        yield Finding(
            finding_codes.STATURE_OUT_OF_RANGE, message, None, severity, world_checks.hint_of_unit(stature_m), evidence
        )


def _check_sides(poses: Track3D, joints: JointSet) -> Iterator[Finding]:
    sides = world_checks.leftness(poses, joints)
    sides = sides[np.isfinite(sides)]
    share = float(np.mean(sides < 0.0)) if len(sides) >= _MIN_FACES else 0.0
    if share >= world_checks.MIRRORED_SHARE:
        message = f"Left and right of {100 * share:.0f} % of the people are exchanged: the world is mirrored."
        hint = "Check whether an axis of the calibration has the wrong sign, or the videos are mirrored."
        yield Finding(
            finding_codes.MIRRORED_WORLD, message, None, "error", hint, {"share": share, "num_people": len(sides)}
        )


def _hangs(poses_m: Float[np.ndarray, "poses joints 3"], joints: JointSet) -> Bool[np.ndarray, " poses"]:
    """Poses with both hands above the shoulders: these people may hang from a bar."""
    if not set(_ARMS) <= set(joints.names):
        return np.zeros(len(poses_m), bool)
    height_m = poses_m[:, joints.indices(_ARMS), 2]
    # Comparisons with NaN are false.
    return np.asarray((height_m[:, :2].min(-1) - height_m[:, 2:].mean(-1)) > OVERHEAD_M)


def _check_heights(
    cameras: Sequence[Camera], poses_m: Float[np.ndarray, "poses joints 3"], joints: JointSet
) -> Iterator[Finding]:
    if not set(_ANKLES) <= set(joints.names):
        return
    if _hangs(poses_m, joints).mean() > _MAX_HANGING:
        return
    ankles_m = poses_m[:, joints.indices(_ANKLES), 2]
    ankles_m = ankles_m[np.isfinite(ankles_m).all(-1)].min(-1)
    if len(ankles_m) < _MIN_POSES:
        return
    floor_m = float(np.median(ankles_m)) - ANKLE_HEIGHT_M
    if abs(floor_m) > _MAX_FLOOR_M:
        message = f"Feet stand at a height of {floor_m:.2f} m, not on the floor at 0."
        hint = f"Move the calibration's origin by {floor_m:.2f} m along Z."
        evidence = {"height_m": floor_m, "num_people": len(ankles_m)}
        yield Finding(finding_codes.FLOOR_NOT_AT_ZERO, message, None, "warning", hint, evidence)
    for camera in cameras:
        height_m = float(center_in_world(camera)[2])
        if height_m < floor_m - _MAX_FLOOR_M:
            message = f"The camera is {floor_m - height_m:.2f} m below the floor that people stand on."
            hint = "Check the calibration's axes."
            yield Finding(
                finding_codes.CAMERA_BELOW_FLOOR, message, camera.name, "warning", hint, {"height_m": height_m}
            )
