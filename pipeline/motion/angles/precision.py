"""Uncertainty of joint angles, propagated from the standard deviations of the joints' positions.

The fit states how precise positions are, not rotations. The orientation of a segment is therefore derived from two
vectors between landmarks (``BodySegment``): a small displacement of a landmark turns the segment by a small rotation
that is linear in it, and an angle changes by its derivative along the difference of the rotations of both segments.
Displacements of landmarks count as independent, and as equal along all axes; a landmark of both segments, such as the
knee, counts once. Rotations that no landmark shows, the tilts of pelvis and thorax, add the usual error of the
skeleton's guess.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.motion import body_segments
from pipeline.motion.skeleton.rotations import unit

_STEP_RAD = 1e-4
# Shortest lever of a rotation: twists of straighter limbs are the model's, about a radian off at worst.
_SHORTEST_M = 0.01


def angle_sigma_rad(
    world_from_segment: Mapping[str, Float[np.ndarray, "frames 3 3"]],
    track: Track3D,
    joints: JointSet,
    joint: body_segments.AngleJoint,
    side: str | None,
) -> Float[np.ndarray, "frames 3"]:
    """Standard deviations of the three angles of a joint's sequence in radians.

    NaN where a landmark has no position or no standard deviation.
    """
    proximal, distal = body_segments.joint_segments(joint, side)
    ends = [body_segments.SEGMENTS[name] for name in (distal, proximal) if name]
    landmarks = sorted({name for end in ends for name in (*end.primary, *end.secondary)})
    sigma_m = track.uncertainty_m
    if sigma_m is None or not set(landmarks) <= set(joints.names):
        return np.full((track.num_frames, 3), np.nan)
    moved = [_rotation_by_landmark(end, track, joints, landmarks) for end in ends]
    relative = moved[0] if proximal is None else moved[0] - moved[1]
    derivative = _derivative(world_from_segment, joint, side)
    sensitivity = np.einsum("fak,lfkx->lfax", derivative, relative)
    variance = np.einsum("lfax,fl->fa", sensitivity**2, sigma_m[:, joints.indices(tuple(landmarks))] ** 2)
    for end in ends:
        along = unit(vector_m(end.primary, track, joints))
        variance += (np.einsum("fak,fk->fa", derivative, along) * np.radians(end.unseen_deg)) ** 2
    return np.asarray(np.sqrt(variance))


def vector_m(weights: Mapping[str, float], track: Track3D, joints: JointSet) -> Float[np.ndarray, "frames 3"]:
    """Vector between landmarks in metres, of their weights by name; NaN where one of them has no position."""
    return np.asarray(sum(weight * track.xyz_m[:, joints.index(name)] for name, weight in weights.items()))


def _derivative(
    world_from_segment: Mapping[str, Float[np.ndarray, "frames 3 3"]], joint: body_segments.AngleJoint, side: str | None
) -> Float[np.ndarray, "frames 3 3"]:
    """Derivatives of the angles of a sequence (rows) by a rotation of the distal segment about the world's axes."""
    proximal, distal = body_segments.joint_segments(joint, side)
    proximal_from_world = np.swapaxes(body_segments.WORLD if proximal is None else world_from_segment[proximal], -1, -2)
    columns = []
    for axis in np.eye(3):
        ends = []
        for step_rad in (_STEP_RAD, -_STEP_RAD):
            turn = Rotation.from_rotvec(step_rad * axis).as_matrix()
            rotation = proximal_from_world @ (turn @ world_from_segment[distal])
            ends.append(
                body_segments.angles_rad(
                    body_segments.mirrored(rotation) if side == "left" else rotation, joint.sequence
                )
            )
        change = (ends[0] - ends[1] + np.pi) % (2 * np.pi) - np.pi
        columns.append(change / (2 * _STEP_RAD))
    return np.stack(columns, axis=-1)


def _rotation_by_landmark(
    segment: body_segments.BodySegment, track: Track3D, joints: JointSet, landmarks: list[str]
) -> Float[np.ndarray, "landmarks frames 3 3"]:
    """Rotations of a segment, in radians about the world's axes, for each metre of displacement of each landmark."""
    first, second = (vector_m(weights, track, joints) for weights in (segment.primary, segment.secondary))
    length_m = np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), _SHORTEST_M)
    along = first / length_m
    shift_m = (second * along).sum(-1, keepdims=True)
    aside_m = second - shift_m * along
    distance_m = np.linalg.norm(aside_m, axis=-1, keepdims=True)
    aside = aside_m / np.maximum(distance_m, 1e-9)
    lever_m = np.maximum(distance_m, _SHORTEST_M)
    normal = np.cross(along, aside)
    # The first vector turns the segment across itself; the second one about the first, and leans with it.
    across = _cross_matrix(along) / length_m[..., None]
    leaning = np.einsum("fi,fij->fj", aside * shift_m / lever_m, across)
    by_first = across + along[:, :, None] * leaning[:, None, :]
    by_second = along[:, :, None] * (normal / lever_m)[:, None, :]
    return np.stack(
        [segment.primary.get(name, 0.0) * by_first + segment.secondary.get(name, 0.0) * by_second for name in landmarks]
    )


def _cross_matrix(vector: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3 3"]:
    """Matrices of the cross product with vectors."""
    zero = np.zeros(len(vector))
    x, y, z = vector.T
    rows = [np.stack([zero, -z, y], axis=-1), np.stack([z, zero, -x], axis=-1), np.stack([-y, x, zero], axis=-1)]
    return np.stack(rows, axis=-2)
