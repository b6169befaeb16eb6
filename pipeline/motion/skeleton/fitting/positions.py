"""Fit the positions of a person's joints over the whole track to the observations of all views.

The energy, for a joint position X in metres at an instant, is the sum of:

- *rays*: see ``fitting.rays``; the scale decreases from step to step (graduated non-convexity);
- *acceleration*: Cauchy's function of the second difference of X, relative to the usual value of the joint at the frame
  rate, times the person's liveliness (``fitting.liveliness``). It is heavy-tailed, because a Gaussian prior would
  smooth away punches and jumps;
- *bones*: squared difference between the length of a limb and the person's own length, the same on both
  sides.

If a view has confused left and right limbs, which then fit clearly better when exchanged, they are exchanged. Each step
reweights and solves for one joint after the other, with the other joints fixed. This is a banded system over time, so
the cost is linear in the length of the track. Long tracks are cut into overlapping windows.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.joints import LIMBS, JointSet
from pipeline.core.progress import OnShare, ignore
from pipeline.core.runtime import large_arrays
from pipeline.core.runtime.jit import as_compiled
from pipeline.motion.skeleton.fitting.fit_kernels import add_bone, solve_over_time
from pipeline.motion.skeleton.fitting.rays import Rays
from pipeline.motion.skeleton.landmarks import Landmarks, limb_lengths_m
from pipeline.motion.skeleton.time_series import Blend, filled_linearly, filled_with_body, windows

# Scales c of the rays, in order of the steps; the last scale is kept.
SCALES_M = (0.20, 0.12, 0.10)
_NUM_STEPS = 12
# Usual accelerations of joints in lively movement, and the factor at which Cauchy's function becomes heavy-tailed.
_USUAL_M_S2 = {
    "shoulder": 7.0, "elbow": 13.0, "wrist": 20.0, "hip": 5.5, "knee": 11.0, "ankle": 14.0, "toe": 17.0, "heel": 17.0,
    "neck": 7.0,
}  # fmt: skip
_USUAL_ELSE_M_S2 = 8.5
_HEAVY_TAIL = 3.0
# Standard deviation of a limb's length between frames, caused by the detector.
_BONE_SIGMA_M = 0.010
# Steps before which sides may be exchanged: at the located positions, and when positions are approximately right.
_STEPS_OF_EXCHANGE = (0, 3, 6)
# Longest step of a joint: rays that are nearly parallel hardly determine the position along them.
_LONGEST_STEP_M = 0.3
# Weight that keeps a joint in place if no other term does.
_INERTIA = 1e-2
_UNKNOWN = np.full(3, np.nan)
MAX_GAP_S = 1.0
"""Longest gap between two measurements of a joint that is filled, and longest time in which a body is followed."""
# Rate from which on a body is near its place in the frames before and behind; below it a person walks 15 cm in a frame.
_FOLLOWED_HZ = 9.3


def usual_step_m(joints: JointSet, timebase: Timebase) -> Float[np.ndarray, " joints"]:
    """Usual second difference of each joint's position between frames, in metres."""
    usual_m_s2 = np.array([_USUAL_M_S2.get(name.rpartition("_")[2], _USUAL_ELSE_M_S2) for name in joints.names])
    return np.asarray(usual_m_s2 / timebase.frame_rate_hz**2)


def tie_weight(
    second_m: Float[np.ndarray, "*batch 3"], usual_m: Float[np.ndarray, "*usual"]
) -> Float[np.ndarray, "*batch"]:
    """Weight of second differences by Cauchy's function of their ratio to the usual value."""
    ratio2 = (second_m**2).sum(-1) / usual_m**2
    return np.asarray(1.0 / (usual_m**2 * (1.0 + ratio2 / _HEAVY_TAIL**2)))


def fit_positions(
    track: Track3D,
    seen: Observations,
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
    lively: Float[np.ndarray, " frames"],
    on_share: OnShare = ignore,
) -> Float[np.ndarray, "frames joints 3"]:
    """Fit the positions of a person's joints.

    ``lively`` is the ratio of the person's accelerations to usual ones, see ``fitting.liveliness``. World positions
    (metres) are of all frames, gaps included; NaN in all for joints that were never located.
    """
    limbs = hanging_limbs(Landmarks(track.xyz_m, track.source, joints, track.views))
    usual_m = lively[:, None] * usual_step_m(joints, timebase)
    may_follow = timebase.frame_rate_hz >= _FOLLOWED_HZ
    fitted_m = large_arrays.empty(track.xyz_m.shape)
    fitted = Blend(fitted_m)
    longest_gap = round(MAX_GAP_S * timebase.frame_rate_hz)
    for rows in windows(track.num_frames, on_share=on_share):
        start_m = track.xyz_m[rows]
        parts = stretches(np.isfinite(start_m).all(-1).any(-1), longest_gap)
        beside_m = start_m if may_follow and len(parts) == 1 else filled_with_body(start_m)
        window_m = np.array(beside_m)
        for stretch in parts:
            seen_rows = slice(rows.start + stretch.start, rows.start + stretch.stop)
            rays = Rays(cameras, seen.points_px[seen_rows], seen.score[seen_rows], joints)
            of_stretch = start_m[stretch], beside_m[stretch]
            window_m[stretch] = _fit_stretch(*of_stretch, rays, limbs, usual_m[seen_rows], may_follow)
        fitted.add(rows, window_m)
    return fitted_m


def stretches(is_seen: Bool[np.ndarray, " frames"], longest_gap: int) -> list[slice]:
    """Ranges of frames between pauses, which are gaps of more than ``longest_gap`` frames without sight of the person.

    A body may be anywhere after a pause. Without any seen frame, all frames are one range. Pauses belong to none,
    except those at the beginning and at the end.
    """
    frames = np.flatnonzero(is_seen)
    pauses = np.flatnonzero(np.diff(frames) > longest_gap + 1)
    starts, stops = [0, *frames[pauses + 1].tolist()], [*(frames[pauses] + 1).tolist(), len(is_seen)]
    return [slice(start, stop) for start, stop in zip(starts, stops, strict=True)]


def hanging_limbs(landmarks: Landmarks) -> list[list[tuple[int, float]]]:
    """Limbs of each joint, as other end and the person's length in metres; see ``landmarks.limb_lengths_m``."""
    joints, lengths_m = landmarks.joints, limb_lengths_m(landmarks)
    hanging: list[list[tuple[int, float]]] = [[] for _ in joints.names]
    for ends in LIMBS:
        length_m = lengths_m[ends[1].rpartition("_")[2]]
        if set(ends) <= set(joints.names) and np.isfinite(length_m):
            upper, lower = joints.indices(ends)
            hanging[upper].append((lower, length_m))
            hanging[lower].append((upper, length_m))
    return hanging


def _fit_stretch(
    start_m: Float[np.ndarray, "frames joints 3"],
    beside_m: Float[np.ndarray, "frames joints 3"],
    rays: Rays,
    limbs: Sequence[Sequence[tuple[int, float]]],
    usual_m: Float[np.ndarray, "frames joints"],
    may_follow: bool,
) -> Float[np.ndarray, "frames joints 3"]:
    """Fit a stretch of frames without a pause; ``beside_m`` are positions beside joints that are seen elsewhere."""
    if may_follow:
        xyz_m = np.stack([filled_linearly(start_m[:, joint], _UNKNOWN) for joint in range(start_m.shape[1])], axis=1)
        xyz_m = np.where(np.isfinite(xyz_m), xyz_m, beside_m)
    else:
        xyz_m = np.array(beside_m)
    is_known = np.isfinite(start_m[..., 0])
    is_followed = may_follow & is_known.any(0)
    # Joints that were never located can't be fitted.
    located = np.flatnonzero(np.isfinite(xyz_m[0, :, 0]))
    for step in range(_NUM_STEPS):
        scale_m = SCALES_M[min(step, len(SCALES_M) - 1)]
        if step in _STEPS_OF_EXCHANGE:
            rays.exchange_sides(xyz_m, scale_m)
        for joint in located.tolist():
            normal, right = rays.normal_equations(joint, xyz_m[:, joint], scale_m)
            here_m = as_compiled(xyz_m[:, joint])
            for other, length_m in limbs[joint] if step > 0 else ():
                # In frames that are far apart, a joint that no camera saw is anywhere, and pulls none that was seen.
                pulls = is_followed[other] | is_known[:, other] | ~is_known[:, joint]
                add_bone(here_m, as_compiled(xyz_m[:, other]), length_m, _BONE_SIGMA_M**-2, pulls, normal, right)
            lower, solved = np.zeros((3 * len(here_m) + 8, 9)), np.zeros(3 * len(here_m) + 8)
            usual = as_compiled(usual_m[:, joint])
            solve_over_time(normal, right, usual, _HEAVY_TAIL, _INERTIA, _LONGEST_STEP_M, lower, solved, here_m)
            xyz_m[:, joint] = here_m
    return xyz_m
