"""Joint angles of a person over time, from the rotations of the fitted skeleton; their ranges and their cycles."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import FINGER_JOINTS, JointSet
from pipeline.motion import body_segments
from pipeline.motion.skeleton.model import INDEX, posed_joints
from pipeline.motion.skeleton.rotations import unit

# Sine of the bend (12 degrees) below which the plane of a limb is uncertain, as in the fit.
_STRAIGHT_SINE = 0.2
# Frames that are worked on at once, so that a long take needs little memory.
_BLOCK_FRAMES = 2048
_JOINTS = tuple((joint, side) for joint in body_segments.JOINTS for side in body_segments.joint_sides(joint))


@dataclass(frozen=True, slots=True, eq=False)
class JointAngles:
    """Joint angles of a person in the frames of a motion."""

    start_frame: int  # Output frame of the first row
    # Angles of ``ANGLE_NAMES`` in degrees, continuous in time; NaN where the rotation was not observed
    angle_deg: Float[np.ndarray, "frames angles"]
    # Standard deviation of each angle in degrees; NaN where the angle or its uncertainty is unknown
    sigma_deg: Float[np.ndarray, "frames angles"]

    @property
    def frames(self) -> range:
        """Output frames of the rows."""
        return range(self.start_frame, self.start_frame + len(self.angle_deg))


def joint_angles(motion: SkeletonMotion, track: Track3D, joints: JointSet, has_sigmas: bool = True) -> JointAngles:
    """Compute the joint angles of a person.

    ``motion``: motion of the skeleton, whose rotations are known in all frames: in gaps they are interpolated.
    ``track``: final positions of the joints in the same frames. An angle is unknown where a landmark of one of its
    segments has no position, or, of hands, where no finger was measured; rotations about the long axis of a limb also
    where the limb is straight. ``joints``: joints of the track. ``has_sigmas``: whether standard deviations are
    computed, which take most of the time; otherwise they are NaN.
    """
    num_frames = len(motion.root_m)
    found_rad, sigma_rad = np.full((2, len(_JOINTS), num_frames, 3), np.nan)
    is_free = np.zeros(found_rad.shape, bool)
    for start in range(0, num_frames, _BLOCK_FRAMES):
        rows = slice(start, start + _BLOCK_FRAMES)
        part = track.part(rows)
        world_from_segment = segments_from(
            replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
        )
        known = observed(part, joints)
        bent = {name: is_bent(name, part, joints) for name in body_segments.SEGMENTS}
        for number, (joint, side) in enumerate(_JOINTS):
            rotation = _proximal_from_distal(world_from_segment, joint, side)
            found_rad[number, rows] = body_segments.angles_rad(rotation, joint.sequence)
            if has_sigmas:
                sigma_rad[number, rows] = angle_sigma_rad(world_from_segment, part, joints, joint, side)
            ends = [name for name in body_segments.joint_segments(joint, side) if name]
            is_free[number, rows] = np.all([known[name] for name in ends], axis=0)[:, None]
            is_free[number, rows, ::2] &= ~body_segments.is_locked(rotation, joint.sequence)[:, None]
            is_free[number, rows, joint.twist] &= np.all([bent[name] for name in ends], axis=0)
    angle_deg, sigma_deg = np.full((2, num_frames, len(body_segments.ANGLE_NAMES)), np.nan)
    for number, (joint, side) in enumerate(_JOINTS):
        turned_deg = np.degrees(body_segments.continuous(found_rad[number], joint.is_proper))
        for angle in joint.angles:
            column, free = (
                body_segments.ANGLE_NAMES.index(body_segments.angle_name(angle, side)),
                is_free[number, :, angle.rotation],
            )
            angle_deg[free, column] = angle.sign * turned_deg[free, angle.rotation]
            sigma_deg[free, column] = np.degrees(sigma_rad[number, free, angle.rotation])
    return JointAngles(motion.start_frame, read_only(angle_deg), read_only(sigma_deg))


def observable_angles(joints: JointSet) -> tuple[str, ...]:
    """Names of the angles that the joints of a detector can show, in the order of ``ANGLE_NAMES``."""
    return tuple(
        body_segments.angle_name(angle, side)
        for joint, side in _JOINTS
        if all(
            _has_landmarks(body_segments.SEGMENTS[name], joints)
            for name in body_segments.joint_segments(joint, side)
            if name
        )
        for angle in joint.angles
    )


def _has_landmarks(segment: body_segments.BodySegment, joints: JointSet) -> bool:
    return {*segment.primary, *segment.secondary} <= set(joints.names)


def segments_from(motion: SkeletonMotion) -> dict[str, Float[np.ndarray, "frames 3 3"]]:
    """Orientations ``world_from_segment`` of all segments of ``SEGMENTS`` by name."""
    _, world_from_joint = posed_joints(motion)
    return {
        name: world_from_joint[INDEX[segment.joint]] @ segment.rest_from_segment
        for name, segment in body_segments.SEGMENTS.items()
    }


def segment_angles(
    world_from_segment: Mapping[str, Float[np.ndarray, "frames 3 3"]],
) -> Float[np.ndarray, "frames angles"]:
    """Angles of ``ANGLE_NAMES`` in radians from orientations of segments, continuous in time.

    NaN for joints one of whose segments is missing. Where a sequence is locked, two of its angles are arbitrary.
    """
    num_frames = len(next(iter(world_from_segment.values())))
    angle_rad = np.full((num_frames, len(body_segments.ANGLE_NAMES)), np.nan)
    for joint, side in _JOINTS:
        if not {name for name in body_segments.joint_segments(joint, side) if name} <= world_from_segment.keys():
            continue
        rotation = _proximal_from_distal(world_from_segment, joint, side)
        turned_rad = body_segments.continuous(body_segments.angles_rad(rotation, joint.sequence), joint.is_proper)
        for angle in joint.angles:
            angle_rad[:, body_segments.ANGLE_NAMES.index(body_segments.angle_name(angle, side))] = (
                angle.sign * turned_rad[:, angle.rotation]
            )
    return angle_rad


def observed(track: Track3D, joints: JointSet) -> dict[str, Bool[np.ndarray, " frames"]]:
    """Frames in which all landmarks of each segment of ``SEGMENTS`` have a position, by name.

    A hand is seen in frames in which one of its fingers was measured or interpolated; other hands rest in a pose of the
    model.
    """
    known = np.isfinite(track.xyz_m).all(-1)
    by_segment = {}
    for name, segment in body_segments.SEGMENTS.items():
        landmarks = sorted({*segment.primary, *segment.secondary})
        if not _has_landmarks(segment, joints):
            by_segment[name] = np.zeros(len(known), bool)
            continue
        by_segment[name] = known[:, joints.indices(tuple(landmarks))].all(1)
        fingers = [landmark for landmark in landmarks if landmark in FINGER_JOINTS]
        if fingers:
            source = track.source[:, joints.indices(tuple(fingers))]
            by_segment[name] &= np.isin(source, (Source.MEASURED, Source.INTERPOLATED)).any(1)
    for name in body_segments.SEGMENTS:
        by_segment[name] |= is_stated(name, track)
    return by_segment


def is_stated(name: str, track: Track3D) -> Bool[np.ndarray, " frames"]:
    """Frames in which the file of a track states the orientation of a segment."""
    if track.world_from_segment is None:
        return np.zeros(track.num_frames, bool)
    return np.isfinite(track.world_from_segment[:, list(body_segments.SEGMENTS).index(name)]).all((-1, -2))


def is_bent(name: str, track: Track3D, joints: JointSet) -> Bool[np.ndarray, " frames"]:
    """Frames in which landmarks show the rotation of a segment about its long axis.

    The twist of a straight arm or leg is not seen: the fit interpolates it from one bend to the next.
    """
    segment = body_segments.SEGMENTS[name]
    if not _has_landmarks(segment, joints):
        return is_stated(name, track)
    along, aside = (unit(vector_m(weights, track, joints)) for weights in (segment.primary, segment.secondary))
    is_seen = np.linalg.norm(np.cross(along, aside), axis=-1) > _STRAIGHT_SINE
    return np.asarray(is_seen | is_stated(name, track))


def _proximal_from_distal(
    world_from_segment: Mapping[str, Float[np.ndarray, "frames 3 3"]], joint: body_segments.AngleJoint, side: str | None
) -> Float[np.ndarray, "frames 3 3"]:
    """Rotation of a joint; the left side is mirrored."""
    proximal, distal = body_segments.joint_segments(joint, side)
    world_from_proximal = body_segments.WORLD if proximal is None else world_from_segment[proximal]
    rotation = np.swapaxes(world_from_proximal, -1, -2) @ world_from_segment[distal]
    return body_segments.mirrored(rotation) if side == "left" else rotation


def ranges_of_motion(angles: JointAngles) -> dict[str, dict[str, float | None]]:
    """Smallest and largest angle, their difference, number of frames and standard deviation of each angle, by name.

    All are in degrees, rounded to 0.01. ``sigma_deg`` is the median over frames, ``None`` where none is stated. An
    angle that was never known is left out.
    """
    found: dict[str, dict[str, float | None]] = {}
    for name, angle_deg, sigma_deg in zip(
        body_segments.ANGLE_NAMES, angles.angle_deg.T, angles.sigma_deg.T, strict=True
    ):
        known_deg, stated_deg = angle_deg[np.isfinite(angle_deg)], sigma_deg[np.isfinite(sigma_deg)]
        if len(known_deg):
            found[name] = {
                "min_deg": round(float(known_deg.min()), 2),
                "max_deg": round(float(known_deg.max()), 2),
                "range_deg": round(float(np.ptp(known_deg)), 2),
                "num_frames": len(known_deg),
                "sigma_deg": round(float(np.median(stated_deg)), 2) if len(stated_deg) else None,
            }
    return found


NUM_POINTS = 101
"""Points of a cycle: 0 to 100 percent."""


def normalised_cycles(
    angle_deg: Float[np.ndarray, " frames"], cycles: Iterable[tuple[float, float]]
) -> Float[np.ndarray, "cycles 101"]:
    """Stretch the cycles of an angle to 0 to 100 percent by linear interpolation.

    ``cycles``: first and last row of each cycle, with fractions. Cycles in which the angle is unknown in a frame, or
    that are not inside the frames, are left out.
    """
    frames, found = np.arange(len(angle_deg)), []
    for start, stop in cycles:
        if not 0.0 <= start < stop <= len(angle_deg) - 1:
            continue
        if np.isfinite(angle_deg[int(start) : int(np.ceil(stop)) + 1]).all():
            found.append(np.interp(np.linspace(start, stop, NUM_POINTS), frames, angle_deg))
    return np.array(found).reshape(-1, NUM_POINTS)


# Uncertainty of joint angles, propagated from the standard deviations of the joints' positions. The fit states how
# precise positions are, not rotations. The orientation of a segment is therefore derived from two vectors between
# landmarks (`BodySegment`): a small displacement of a landmark turns the segment by a small rotation that is linear in
# it, and an angle changes by its derivative along the difference of the rotations of both segments. Displacements of
# landmarks count as independent, and as equal along all axes; a landmark of both segments, such as the knee, counts
# once. Rotations that no landmark shows, the tilts of pelvis and thorax, add the usual error of the skeleton's guess.
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
