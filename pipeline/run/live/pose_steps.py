"""Gauss-Newton steps of one pose: the energy of ``skeleton.fitting.gauss_newton`` for a single frame, without its cost.

That module fits windows of frames, and calls SciPy's rotations for each of its terms. For a single frame these calls
take 3 ms; here all joints are computed at once, in a tenth of the time.
"""

import numpy as np
from jaxtyping import Float

from pipeline.motion.skeleton.fitting.articulation import NUM_ROOT, Articulation
from pipeline.motion.skeleton.fitting.fit_kernels import assemble
from pipeline.motion.skeleton.fitting.gauss_newton import Evidence, JointPoses, Posed, move
from pipeline.motion.skeleton.model import INDEX, SKELETON

# Priors of ``skeleton.fitting.gauss_newton``.
_TWIST_RAD, _TWIST_LIMIT_RAD = 1.5, 0.3
_INERTIA, _AT_END_RAD, _HELD = 1.0, 1e-9, 1e12
_LEAST_TWIST_SQUARE = 0.05


def quaternions_from_matrices(matrices: Float[np.ndarray, "joints 3 3"]) -> Float[np.ndarray, "joints 4"]:
    """Quaternions (x, y, z, w) of rotation matrices.

    The products of a quaternion's components are sums of the matrix's entries; those with the largest component are
    exact enough for all rotations (Shepperd, "Quaternion from rotation matrix", 1978).
    """
    m = np.moveaxis(matrices, 0, -1)
    products = np.empty((4, 4, len(matrices)))
    for axis in range(3):
        before, behind = (axis + 1) % 3, (axis + 2) % 3
        products[axis, axis] = 1.0 + m[axis, axis] - m[before, before] - m[behind, behind]
        products[axis, before] = products[before, axis] = m[axis, before] + m[before, axis]
        products[axis, 3] = products[3, axis] = m[behind, before] - m[before, behind]
    products[3, 3] = 1.0 + m[0, 0] + m[1, 1] + m[2, 2]
    largest = products[range(4), range(4)].argmax(0)
    quat = products[largest, :, range(len(matrices))]
    return np.asarray(quat / np.linalg.norm(quat, axis=-1, keepdims=True))


class PoseSteps:
    """Steps of the pose of a skeleton; its tables are made once."""

    def __init__(self, skeleton: Articulation) -> None:
        self._skeleton = skeleton
        count = skeleton.num_freedoms
        self._square = np.tril_indices(count)
        drawn = [
            (n, freedom) for n, freedom in enumerate(skeleton.freedoms, NUM_ROOT) if np.isfinite(freedom.usual_rad)
        ]
        self._drawn = np.array([number for number, _ in drawn])
        self._drawn_joint = skeleton.freedom_joint[self._drawn, 0]
        self._drawn_axis = np.array([freedom.axis for _, freedom in drawn])
        self._above_rad = np.array([freedom.usual_rad for _, freedom in drawn])
        self._below_rad = np.array([freedom.usual_below_rad or freedom.usual_rad for _, freedom in drawn])
        self._twist_joint = np.array([INDEX[twist.joint] for twist in skeleton.twists])
        self._twist_first = np.array(
            [
                next(n for n, freedom in enumerate(skeleton.freedoms, NUM_ROOT) if freedom.joints == (twist.joint,))
                for twist in skeleton.twists
            ]
        )
        self._bone = np.array([SKELETON[INDEX[twist.child]].rest_direction for twist in skeleton.twists])
        self._twist_limits_rad = np.array([twist.limits_rad for twist in skeleton.twists]).T

    def take(self, poses: JointPoses, evidence: Evidence, num_steps: int) -> None:
        """Improve a pose, in place."""
        for _ in range(num_steps):
            move(poses, self._skeleton, self._step(poses, evidence))

    def _step(self, poses: JointPoses, evidence: Evidence) -> Float[np.ndarray, "1 freedoms"]:
        skeleton = self._skeleton
        count = skeleton.num_freedoms
        posed = Posed(poses, skeleton)
        num_landmarks = len(skeleton.landmark)
        lower, force = np.zeros((count, 3 * count)), np.zeros(count)
        curvature, pull = evidence.normal_equations(posed.landmark_m)
        assemble(
            posed.jacobian(),
            skeleton.moved_by,
            skeleton.num_moved_by,
            curvature,
            pull,
            np.empty((0, num_landmarks)),
            np.empty((0, num_landmarks, 3)),
            lower,
            force,
        )
        matrix = np.zeros((count, count))
        rows, columns = self._square
        matrix[rows, columns] = lower[columns, rows - columns]
        quat = quaternions_from_matrices(poses.local[0])
        self._draw_to_rest(quat, matrix, force)
        self._draw_twist(quat, matrix, force)
        angle_rad = poses.angle_rad[0]
        for end_rad, outwards in ((skeleton.lowest_rad, -1.0), (skeleton.highest_rad, 1.0)):
            at_end = (outwards * (angle_rad - end_rad) >= -_AT_END_RAD) & (outwards * force > 0)
            np.fill_diagonal(matrix, matrix.diagonal() + np.where(at_end, _HELD, 0.0))
        np.fill_diagonal(matrix, matrix.diagonal() + _INERTIA)
        matrix[columns, rows] = matrix[rows, columns]
        return np.asarray(np.linalg.solve(matrix, force)[None])

    def _draw_to_rest(
        self,
        quat: Float[np.ndarray, "joints 4"],
        matrix: Float[np.ndarray, "freedoms freedoms"],
        force: Float[np.ndarray, " freedoms"],
    ) -> None:
        """Add the priors for the rest pose, in place."""
        quat = quat[self._drawn_joint]
        vector, w = quat[:, :3] * np.where(quat[:, 3:] < 0, -1.0, 1.0), np.abs(quat[:, 3])
        sine = np.linalg.norm(vector, axis=-1)
        scale = np.where(sine > 1e-9, 2 * np.arctan2(sine, w) / np.maximum(sine, 1e-9), 2.0)
        angle_rad = scale * (vector * self._drawn_axis).sum(-1)
        strength = 1.0 / np.where(angle_rad < 0, self._below_rad, self._above_rad) ** 2
        matrix[self._drawn, self._drawn] += strength
        force[self._drawn] -= strength * angle_rad

    def _draw_twist(
        self,
        quat: Float[np.ndarray, "joints 4"],
        matrix: Float[np.ndarray, "freedoms freedoms"],
        force: Float[np.ndarray, " freedoms"],
    ) -> None:
        """Add the priors for the twist of upper arms and thighs, in place; see ``gauss_newton``."""
        vector, w = quat[self._twist_joint, :3], quat[self._twist_joint, 3:]
        along = (vector * self._bone).sum(-1, keepdims=True)
        angle_rad = (2 * np.arctan2(along, w)[:, 0] + np.pi) % (2 * np.pi) - np.pi
        turned = w**2 * self._bone + w * np.cross(self._bone, vector) + along * vector
        gradient = turned / np.maximum(w**2 + along**2, _LEAST_TWIST_SQUARE)
        beyond_rad = angle_rad - np.clip(angle_rad, *self._twist_limits_rad)
        weight = 1.0 / _TWIST_RAD**2 + (beyond_rad != 0.0) / _TWIST_LIMIT_RAD**2
        force_rad = -(angle_rad / _TWIST_RAD**2 + beyond_rad / _TWIST_LIMIT_RAD**2)
        for first, along_rad, strength, pull_rad in zip(
            self._twist_first.tolist(), gradient, weight, force_rad, strict=True
        ):
            own = slice(first, first + 3)
            matrix[own, own] += strength * np.outer(along_rad, along_rad)
            force[own] += pull_rad * along_rad
