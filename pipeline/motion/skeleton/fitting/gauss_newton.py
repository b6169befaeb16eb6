"""Fit the skeleton's degrees of freedom to the evidence in a window of frames, by the Gauss-Newton method.

The energy, a function of the root's position and all rotations of ``articulation.FREEDOMS``, is the sum of:

- the evidence for landmarks: rays of all views, or positions (``Evidence``);
- Cauchy's function of the landmarks' second differences (``positions.tie_weight``);
- priors for unobservable rotations: the rest pose for bends of spine, neck and collar bones; for the twist of upper
  arms and thighs the rest pose, small changes between frames, and limits.

The parametrisation keeps bone lengths constant, and gives elbows and knees one axis and a range of angles. A hinge at
its limit stays there while the gradient points outwards.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation
from threadpoolctl import ThreadpoolController

from pipeline.core.runtime.jit import as_compiled
from pipeline.motion.skeleton.fitting.articulation import NUM_ROOT, Articulation
from pipeline.motion.skeleton.fitting.fit_kernels import assemble, differentiate, pose, turn
from pipeline.motion.skeleton.fitting.positions import tie_weight
from pipeline.motion.skeleton.model import INDEX, SKELETON
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw

# Twist: standard deviations from the rest pose, of the speed, and beyond the limits.
_TWIST_RAD, _TWIST_RAD_S, _TWIST_LIMIT_RAD = 1.5, 4.0, 0.3
# Longest step of a rotation: beyond it, the quadratic approximation of the energy is poor. And the weight that keeps a
# rotation in place if no other term does.
_LONGEST_STEP_RAD = 0.3
_INERTIA = 1.0
_AT_END_RAD = 1e-9
_HELD = 1e12
_LIBRARIES = ThreadpoolController()


@runtime_checkable
class Evidence(Protocol):
    """Evidence for the positions of landmarks."""

    def normal_equations(
        self, landmark_m: Float[np.ndarray, "frames landmarks 3"]
    ) -> tuple[Float[np.ndarray, "frames landmarks 3 3"], Float[np.ndarray, "frames landmarks 3"]]:
        """Curvature and negative gradient of the energy at the current positions of landmarks (metres)."""
        ...


@dataclass(slots=True, eq=False)
class JointPoses:
    """Pose of a person in each frame of a window; changed by the fit."""

    root_m: Float[np.ndarray, "frames 3"]  # World position of the root
    local: Float[np.ndarray, "frames joints 3 3"]  # Rotation matrix of each joint to its parent
    angle_rad: Float[np.ndarray, "frames freedoms"]  # Angle of each hinge, by degree of freedom; 0 for other rotations
    # Steps from each frame to the next that no pause parts, see ``positions.stretches``; ``None``: there is no pause
    is_tied: Bool[np.ndarray, " steps"] | None = None

    def quat_xyzw(self) -> Float[np.ndarray, "frames joints 4"]:
        """Rotations of all joints to their parents as quaternions (x, y, z, w), continuous in time."""
        joints = range(self.local.shape[1])
        return np.stack(
            [continuous_quat_xyzw(Rotation.from_matrix(self.local[:, joint], assume_valid=True)) for joint in joints],
            axis=1,
        )


def start_from(
    root_m: Float[np.ndarray, "frames 3"],
    parent_from_joint: Float[np.ndarray, "frames joints 4"],
    skeleton: Articulation,
) -> JointPoses:
    """Build bodies from any pose. Rotations of hinges are reduced to their axis and clipped to their limits."""
    num_frames = len(root_m)
    local = Rotation.from_quat(parent_from_joint.reshape(-1, 4)).as_matrix().reshape(num_frames, -1, 3, 3)
    angle_rad = np.zeros((num_frames, skeleton.num_freedoms))
    for number, freedom in enumerate(skeleton.freedoms, NUM_ROOT):
        if freedom.limits_rad:
            joint, axis = INDEX[freedom.joints[0]], np.array(freedom.axis)
            bend = Rotation.from_quat(parent_from_joint[:, joint]).as_rotvec() @ axis
            angle_rad[:, number] = np.clip(bend, *freedom.limits_rad)
            local[:, joint] = Rotation.from_rotvec(angle_rad[:, [number]] * axis).as_matrix()
    return JointPoses(np.array(root_m), local, angle_rad)


def landmark_positions(bodies: JointPoses, skeleton: Articulation) -> Float[np.ndarray, "frames landmarks 3"]:
    """World positions of landmarks (metres)."""
    return Posed(bodies, skeleton).landmark_m


class Posed:
    """World positions and orientations of all joints, and positions of landmarks."""

    def __init__(self, bodies: JointPoses, skeleton: Articulation) -> None:
        self._skeleton = skeleton
        num_frames, num_joints = bodies.local.shape[:2]
        self.world = np.empty((num_frames, num_joints, 3, 3))
        self.joint_m = np.empty((num_frames, num_joints, 3))
        self.landmark_m = np.empty((num_frames, len(skeleton.landmark), 3))
        pose(
            bodies.root_m,
            bodies.local,
            skeleton.parent,
            skeleton.offset_m,
            skeleton.landmark_joint,
            skeleton.landmark_offset_m,
            self.world,
            self.joint_m,
            self.landmark_m,
        )

    def jacobian(self) -> Float[np.ndarray, "frames landmarks most 3"]:
        """Derivatives of landmarks by the degrees of freedom that move them (``Articulation.moved_by``)."""
        skeleton = self._skeleton
        result = np.empty((len(self.world), *skeleton.moved_by.shape, 3))
        differentiate(
            self.world,
            self.joint_m,
            self.landmark_m,
            skeleton.freedom_joint,
            skeleton.freedom_axis,
            skeleton.moved_by,
            skeleton.num_moved_by,
            result,
        )
        return result


def move(bodies: JointPoses, skeleton: Articulation, step: Float[np.ndarray, "frames freedoms"]) -> None:
    """Apply a step to all degrees of freedom in place; rotations are limited a step, and hinges to their range."""
    turn(
        step,
        skeleton.freedom_joint,
        skeleton.freedom_axis,
        skeleton.lowest_rad,
        skeleton.highest_rad,
        _LONGEST_STEP_RAD,
        bodies.root_m,
        bodies.angle_rad,
        bodies.local,
    )


def refine(
    bodies: JointPoses,
    skeleton: Articulation,
    evidence: Evidence,
    usual_m: Float[np.ndarray, "*differences landmarks"],
    frame_rate_hz: float,
    num_steps: int,
    damping: float = 0.0,
) -> None:
    """Refine bodies by Gauss-Newton steps, in place.

    ``usual_m`` are the usual second differences of landmarks in metres, the same for all frames or one for each of the
    ``frames - 2`` differences; infinite for landmarks without this term. ``damping`` (Levenberg 1944) makes steps
    shorter where a limb is straight and its bend hardly moves anything; in 1 / variance of a rotation.
    """
    for _ in range(num_steps):
        move(bodies, skeleton, _step(bodies, skeleton, evidence, usual_m, frame_rate_hz, damping))


def _step(
    bodies: JointPoses,
    skeleton: Articulation,
    evidence: Evidence,
    usual_m: Float[np.ndarray, "*differences landmarks"],
    frame_rate_hz: float,
    damping: float,
) -> Float[np.ndarray, "frames freedoms"]:
    system = linearise(bodies, skeleton, evidence, usual_m, frame_rate_hz)
    system.lower.reshape(*system.right.shape, -1)[:, NUM_ROOT:, 0] += damping
    return system.solve(system.right.ravel()).reshape(system.right.shape)


@dataclass(frozen=True, slots=True, eq=False)
class LinearSystem:
    """Normal equations of a Gauss-Newton step, and the terms of landmarks that they were made of."""

    lower: Float[np.ndarray, "unknowns below"]  # Lower diagonals of the matrix; unknowns of a frame are consecutive
    right: Float[np.ndarray, "frames freedoms"]
    jacobian: Float[np.ndarray, "frames landmarks most 3"]
    # Curvature and negative gradient of the landmarks' evidence
    curvature: Float[np.ndarray, "frames landmarks 3 3"]
    pull: Float[np.ndarray, "frames landmarks 3"]

    def solve(self, right: Float[np.ndarray, "unknowns *sides"]) -> Float[np.ndarray, "unknowns *sides"]:
        """Solve for one or several right sides. The matrix is overwritten: call it once."""
        # One thread: in such a narrow band, several threads would mostly wait, and could round differently.
        with _LIBRARIES.limit(limits=1, user_api="blas"):
            return np.asarray(solveh_banded(self.lower.T, right, lower=True, overwrite_ab=True, check_finite=False))


def linearise(
    bodies: JointPoses,
    skeleton: Articulation,
    evidence: Evidence,
    usual_m: Float[np.ndarray, "*differences landmarks"],
    frame_rate_hz: float,
) -> LinearSystem:
    """Normal equations at a pose; for the arguments see ``refine``."""
    num_frames, num_freedoms = len(bodies.root_m), skeleton.num_freedoms
    posed = Posed(bodies, skeleton)
    jacobian = posed.jacobian()
    second_m = np.diff(posed.landmark_m, n=2, axis=0)
    tie = tie_weight(second_m, usual_m)
    if bodies.is_tied is not None:
        tie *= (bodies.is_tied[1:] & bodies.is_tied[:-1])[:, None]
    lower, right = np.zeros((num_frames * num_freedoms, 3 * num_freedoms)), np.zeros(num_frames * num_freedoms)
    curvature, pull = map(as_compiled, evidence.normal_equations(posed.landmark_m))
    assemble(jacobian, skeleton.moved_by, skeleton.num_moved_by, curvature, pull, tie, second_m, lower, right)
    by_frame, force = lower.reshape(num_frames, num_freedoms, -1), right.reshape(num_frames, num_freedoms)
    _draw_to_rest(bodies, skeleton, by_frame, force)
    _steady_twist(bodies, skeleton, frame_rate_hz, by_frame, force)
    ends = [(skeleton.lowest_rad, -1.0), (skeleton.highest_rad, 1.0)]
    for end_rad, outwards in ends:
        at_end = (outwards * (bodies.angle_rad - end_rad) >= -_AT_END_RAD) & (outwards * force > 0)
        by_frame[..., 0] += np.where(at_end, _HELD, 0.0)
    by_frame[..., 0] += _INERTIA
    return LinearSystem(lower, force, jacobian, curvature, pull)


def _draw_to_rest(
    bodies: JointPoses,
    skeleton: Articulation,
    lower: Float[np.ndarray, "frames freedoms below"],
    force: Float[np.ndarray, "frames freedoms"],
) -> None:
    """Add the priors for the rest pose, in place."""
    drawn = [(n, freedom) for n, freedom in enumerate(skeleton.freedoms, NUM_ROOT) if np.isfinite(freedom.usual_rad)]
    turning = {n: int(skeleton.freedom_joint[n, 0]) for n, freedom in drawn if freedom.limits_rad is None}
    joints = sorted(set(turning.values()))
    local = bodies.local[:, joints]
    rotvec = Rotation.from_matrix(local.reshape(-1, 3, 3), assume_valid=True).as_rotvec().reshape(*local.shape[:2], 3)
    for number, freedom in drawn:
        angle_rad = (
            rotvec[:, joints.index(turning[number])] @ np.array(freedom.axis)
            if number in turning
            else bodies.angle_rad[:, number] - freedom.rest_rad
        )
        spread_rad = freedom.spread_rad(angle_rad)
        lower[:, number, 0] += 1.0 / spread_rad**2
        force[:, number] -= angle_rad / spread_rad**2


def _steady_twist(
    bodies: JointPoses,
    skeleton: Articulation,
    frame_rate_hz: float,
    lower: Float[np.ndarray, "frames freedoms below"],
    force: Float[np.ndarray, "frames freedoms"],
) -> None:
    """Add the priors for the twist of upper arms and thighs, in place."""
    num_freedoms = force.shape[1]
    usual_change_rad = _TWIST_RAD_S / frame_rate_hz
    for twist in skeleton.twists:
        joint = INDEX[twist.joint]
        first = next(n for n, freedom in enumerate(skeleton.freedoms, NUM_ROOT) if freedom.joints == (twist.joint,))
        bone = np.array(SKELETON[INDEX[twist.child]].rest_direction)
        local = bodies.local[:, joint]
        angle_rad, gradient = _twist(Rotation.from_matrix(local, assume_valid=True).as_quat(), bone)
        beyond_rad = angle_rad - np.clip(angle_rad, *twist.limits_rad)
        weight = 1.0 / _TWIST_RAD**2 + (beyond_rad != 0.0) / _TWIST_LIMIT_RAD**2
        force_rad = -(angle_rad / _TWIST_RAD**2 + beyond_rad / _TWIST_LIMIT_RAD**2)
        # Rotation from each frame to the next in the joint's axes; its component along the bone is the change of twist.
        relative = np.einsum("fba,fbc->fac", local[:-1], local[1:])
        change_rad = Rotation.from_matrix(relative, assume_valid=True).as_rotvec() @ bone
        before = -relative @ bone
        tied = np.full(len(change_rad), 1.0 / usual_change_rad**2)
        if bodies.is_tied is not None:
            tied *= bodies.is_tied
        force[:, first : first + 3] += force_rad[:, None] * gradient
        force[:-1, first : first + 3] -= (tied * change_rad)[:, None] * before
        force[1:, first : first + 3] -= (tied * change_rad)[:, None] * bone
        for k in range(3):
            for m in range(3):
                lower[:-1, first + k, num_freedoms + m - k] += tied * before[:, k] * bone[m]
                if m >= k:
                    lower[:, first + k, m - k] += weight * gradient[:, k] * gradient[:, m]
                    lower[:-1, first + k, m - k] += tied * before[:, k] * before[:, m]
                    lower[1:, first + k, m - k] += tied * bone[k] * bone[m]


def _twist(
    quat_xyzw: Float[np.ndarray, "frames 4"], bone: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " frames"], Float[np.ndarray, "frames 3"]]:
    """Twist about a bone before a swing without twist, and its gradient by a small rotation in the joint's axes.

    With q = (v, w), the twist is 2 atan2(v b, w), and its gradient (w^2 b + w b x v + (v b) v) / (w^2 + (v b)^2). The
    twist is undefined for a half turn of the bone, so the gradient is bounded there.
    """
    vector, w = quat_xyzw[:, :3], quat_xyzw[:, 3]
    along = vector @ bone
    angle_rad = 2 * np.arctan2(along, w)
    angle_rad = (angle_rad + np.pi) % (2 * np.pi) - np.pi
    w, along = w[:, None], along[:, None]
    gradient = (w**2 * bone + w * np.cross(bone, vector) + along * vector) / np.maximum(w**2 + along**2, 0.05)
    return angle_rad, gradient
