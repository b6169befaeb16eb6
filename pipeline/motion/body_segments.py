"""Definitions of joint angles: frames of segments, joints between them, sequences of rotations, names and signs.

Definitions follow the International Society of Biomechanics: Wu et al. 2002 (ankle, hip, spine), Grood and Suntay
1983 (knee), Wu et al. 2005 (shoulder, elbow, wrist), and Baker 2001 for the pelvis in the world. The axes of every
segment are X to the front, Y up along the segment, and Z to the right, in the anatomical position: upright, arms
hanging, palms to the front. All angles are then zero. Where a body without markers can't follow the definitions,
docs/guide/biomechanics.md says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.joints import SIDES

Sequence = tuple[int, int, int]
"""Axes of three rotations, each about an axis of the frame that the rotations before it have turned: X 0, Y 1, Z 2."""

_Y = 1
_ZXY, _YXZ, _YXY, _YZX = (2, 0, 1), (1, 0, 2), (1, 0, 1), (1, 2, 0)

# Axes of segments as columns, in the axes of the skeleton's rest pose (world axes of a T-pose, palms down). Arms of the
# T-pose are the axes of the anatomical position raised aside, and hands are turned over.
_UPRIGHT = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))
_ARMS = {
    "left": ((0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    "right": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
}
_HANDS = {
    "left": ((0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "right": ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
}
WORLD: Float[np.ndarray, "3 3"] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation ``world_from_laboratory`` of the frame in which the pelvis is turned: X along the world's X, Y up."""


@dataclass(frozen=True, slots=True)
class BodySegment:
    """BodySegment of the body with a frame of its own.

    ``primary`` and ``secondary`` are vectors between landmarks, as weights by name: the first one gives two of the
    segment's rotations, the second one the rotation about the first. They serve for uncertainty, and for what must be
    known of a segment.
    """

    joint: str  # Joint of the skeleton that turns the segment
    axes: tuple[tuple[float, float, float], ...]  # X, Y and Z of the segment in the axes of the rest pose
    primary: Mapping[str, float]
    secondary: Mapping[str, float]
    # Usual error of the rotation about ``primary``, in degrees, that landmarks don't show
    unseen_deg: float = 0.0

    @property
    def rest_from_segment(self) -> Float[np.ndarray, "3 3"]:
        """Rotation from the segment's axes to the axes of the rest pose."""
        return np.array(self.axes).T


@dataclass(frozen=True, slots=True)
class Angle:
    """Angle of a joint: one rotation of its sequence."""

    name: str  # Name after the joint's side, such as ``hip_flexion``
    rotation: int  # Place in the sequence, 0 to 2
    sign: float  # 1 if the angle is positive in the sense of the axis, otherwise -1
    meaning: str  # Meaning of a positive angle


@dataclass(frozen=True, slots=True)
class AngleJoint:
    """Joint between two segments, and the angles that its sequence of rotations gives.

    ``proximal`` and ``distal`` are names of segments without a side; the laboratory is ``world``. Segments of the left
    side are mirrored, so that angles have the same sign on both sides.
    """

    proximal: str
    distal: str
    sequence: Sequence
    angles: tuple[Angle, ...]

    @property
    def is_sided(self) -> bool:
        """Return whether there is a joint on each side."""
        return self.distal not in _TRUNK

    @property
    def is_proper(self) -> bool:
        """Sameness of the first and the third axis, so that the second angle is locked at 0 and 180 degrees.

        Other sequences are locked where the second angle is 90 degrees.
        """
        return self.sequence[0] == self.sequence[2]

    @property
    def twist(self) -> int:
        """Place in the sequence of the rotation about the long axis of a limb, the last one about Y."""
        return max(place for place, axis in enumerate(self.sequence) if axis == _Y)


JOINTS = tuple(
    AngleJoint(proximal, distal, sequence, angles)
    for (proximal, distal, sequence), angles in {
        ("world", "pelvis", _YXZ): (
            Angle("pelvis_rotation", 0, 1.0, "heading to the left of the world's X axis"),
            Angle("pelvis_obliquity", 1, 1.0, "right side lower"),
            Angle("pelvis_tilt", 2, -1.0, "tilted to the front"),
        ),
        ("pelvis", "thorax", _ZXY): (
            Angle("trunk_flexion", 0, -1.0, "bent to the front"),
            Angle("trunk_bending", 1, 1.0, "bent to the right"),
            Angle("trunk_rotation", 2, 1.0, "turned to the left"),
        ),
        ("thorax", "head", _ZXY): (
            Angle("neck_flexion", 0, -1.0, "bent to the front"),
            Angle("neck_bending", 1, 1.0, "bent to the right"),
            Angle("neck_rotation", 2, 1.0, "turned to the left"),
        ),
        ("pelvis", "thigh", _ZXY): (
            Angle("hip_flexion", 0, 1.0, "thigh to the front"),
            Angle("hip_adduction", 1, 1.0, "thigh to the middle"),
            Angle("hip_rotation", 2, 1.0, "internal"),
        ),
        ("thigh", "shank", _ZXY): (Angle("knee_flexion", 0, -1.0, "bent"),),
        ("shank", "foot", _ZXY): (
            Angle("ankle_dorsiflexion", 0, 1.0, "toes up"),
            Angle("subtalar_inversion", 1, 1.0, "sole to the middle"),
            Angle("ankle_rotation", 2, 1.0, "internal"),
        ),
        ("thorax", "upper_arm", _ZXY): (
            Angle("shoulder_flexion", 0, 1.0, "arm to the front"),
            Angle("shoulder_adduction", 1, 1.0, "arm to the middle; abduction is negative"),
            Angle("shoulder_rotation", 2, 1.0, "internal"),
        ),
        ("thorax", "upper_arm", _YXY): (
            Angle("shoulder_plane", 0, 1.0, "plane of elevation: 0 aside, 90 to the front"),
            Angle("shoulder_elevation", 1, -1.0, "arm away from hanging, 0 to 180"),
            Angle("shoulder_axial", 2, 1.0, "internal, after plane and elevation"),
        ),
        ("upper_arm", "forearm", _ZXY): (Angle("elbow_flexion", 0, 1.0, "bent"),),
        ("forearm", "hand", _YZX): (
            Angle("forearm_pronation", 0, 1.0, "palm to the back; 0 with the palm to the front"),
            Angle("wrist_flexion", 1, 1.0, "palm to the forearm"),
            Angle("wrist_deviation", 2, 1.0, "to the little finger"),
        ),
    }.items()
)
"""Joints from the pelvis outwards."""

# Hips and shoulders are two lines: how a trunk that bends to the front shares its bend is the skeleton's guess. Errors
# of the tilt in simulated walks, squats and kicks (docs/lab/angles.md).
_PELVIS_DEG, _THORAX_DEG = 5.0, 3.0
_MIDDLE_UP = {"left_shoulder": 0.5, "right_shoulder": 0.5, "left_hip": -0.5, "right_hip": -0.5}


def _between(start: str, end: str) -> Mapping[str, float]:
    return {start: -1.0, end: 1.0}


def _limbs(side: str) -> dict[str, BodySegment]:
    prefix, arm, hand = side.capitalize(), _ARMS[side], _HANDS[side]

    def bone(start: str, end: str) -> Mapping[str, float]:
        return _between(f"{side}_{start}", f"{side}_{end}")

    return {
        f"{side}_thigh": BodySegment(f"{prefix}UpLeg", _UPRIGHT, bone("hip", "knee"), bone("knee", "ankle")),
        f"{side}_shank": BodySegment(f"{prefix}Leg", _UPRIGHT, bone("knee", "ankle"), bone("hip", "knee")),
        f"{side}_foot": BodySegment(f"{prefix}Foot", _UPRIGHT, bone("heel", "big_toe"), bone("heel", "ankle")),
        f"{side}_upper_arm": BodySegment(f"{prefix}Arm", arm, bone("shoulder", "elbow"), bone("elbow", "wrist")),
        f"{side}_forearm": BodySegment(f"{prefix}ForeArm", arm, bone("elbow", "wrist"), bone("shoulder", "elbow")),
        f"{side}_hand": BodySegment(f"{prefix}Hand", hand, bone("wrist", "middle_mcp"), bone("pinky_mcp", "index_mcp")),
    }


SEGMENTS: Mapping[str, BodySegment] = MappingProxyType(
    {
        "pelvis": BodySegment("Hips", _UPRIGHT, _between("left_hip", "right_hip"), _MIDDLE_UP, _PELVIS_DEG),
        "thorax": BodySegment("Chest", _UPRIGHT, _between("left_shoulder", "right_shoulder"), _MIDDLE_UP, _THORAX_DEG),
        "head": BodySegment(
            "Head", _UPRIGHT, _between("left_ear", "right_ear"), {"left_ear": -0.5, "right_ear": -0.5, "nose": 1.0}
        ),
        **_limbs("left"),
        **_limbs("right"),
    }
)
"""Segments by name; names of limbs begin with the side."""

_TRUNK = {"pelvis": "pelvis", "thorax": "torso", "head": "head"}
_LIMBS = {"thigh": "thigh", "shank": "shank", "foot": "foot", "upper_arm": "uarm", "forearm": "larm", "hand": "hand"}
SEGMENT_LABELS: Mapping[str, str] = MappingProxyType(
    {name: f"{label}_4X4" for name, label in _TRUNK.items()}
    | {f"{side}_{name}": f"{side[0]}_{label}_4X4" for side in ("left", "right") for name, label in _LIMBS.items()}
)
"""Labels of the segments in the group ROTATION of C3D files, as Theia3D writes them, by name."""
RIGHT_FRONT_UP = [2, 0, 1]
"""Columns of the axes in such files among a segment's axes: right, front, up."""


def joint_sides(joint: AngleJoint) -> tuple[str | None, ...]:
    """Sides on which there is a joint; ``None`` for a joint of the trunk."""
    return SIDES if joint.is_sided else (None,)


def angle_name(angle: Angle, side: str | None) -> str:
    """Full name of an angle, such as ``left_hip_flexion``."""
    return angle.name if side is None else f"{side}_{angle.name}"


def joint_segments(joint: AngleJoint, side: str | None) -> tuple[str | None, str]:
    """Names of the proximal and the distal segment of a joint; ``None`` for the world."""

    def named(segment: str) -> str:
        return segment if segment in SEGMENTS else f"{side}_{segment}"

    return None if joint.proximal == "world" else named(joint.proximal), named(joint.distal)


ANGLE_NAMES: tuple[str, ...] = tuple(
    angle_name(angle, side) for joint in JOINTS for side in joint_sides(joint) for angle in joint.angles
)
"""Full names of all angles, in the order of columns."""


_MIRROR = np.diag([1.0, 1.0, -1.0])
_FULL = 2.0 * np.pi
# Sine of the angle between the first and the third axis (10 degrees) below which their angles are told apart poorly.
_LOCKED_SINE = float(np.sin(np.radians(10.0)))


def mirrored(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotations in the mirror that exchanges left and right: Z is the axis to the right."""
    return np.asarray(_MIRROR @ rotation @ _MIRROR)


def angles_rad(rotation: Float[np.ndarray, "*batch 3 3"], sequence: Sequence) -> Float[np.ndarray, "*batch 3"]:
    """Angles of a sequence of rotations, each about an axis of the frame that the rotations before it have turned.

    ``rotation`` are ``proximal_from_distal``. Angles are in radians: the second one in [-90, 90] degrees, or in
    [-180, 0] if the first and the third axis are the same; the others in [-180, 180]. Where the sequence is locked, the
    first and the third angle are arbitrary. NaN where the rotation has NaN.

    >>> from scipy.spatial.transform import Rotation
    >>> turn = Rotation.from_euler("ZXY", [10.0, 20.0, 30.0], degrees=True).as_matrix()
    >>> np.degrees(angles_rad(turn, (2, 0, 1))).round(6)
    array([10., 20., 30.])
    """
    first, second, third = sequence
    other = 3 - first - second
    sign = 1.0 if (second - first) % 3 == 1 else -1.0
    entry = rotation[..., first, :]
    if first == third:
        # R = R1(a) R2(b) R1(c): the first row is (cos b, sin b sin c, s sin b cos c), the first column likewise.
        beta = -np.arccos(np.clip(entry[..., first], -1.0, 1.0))
        alpha = np.arctan2(-rotation[..., second, first], sign * rotation[..., other, first])
        gamma = np.arctan2(-entry[..., second], -sign * entry[..., other])
    else:
        # R = R1(a) R2(b) R3(c): the entry of the first row and the third column is s sin b.
        beta = np.arcsin(np.clip(sign * entry[..., third], -1.0, 1.0))
        alpha = np.arctan2(-sign * rotation[..., second, third], rotation[..., third, third])
        gamma = np.arctan2(-sign * entry[..., second], entry[..., first])
    return np.stack([alpha, beta, gamma], axis=-1)


def is_locked(rotation: Float[np.ndarray, "*batch 3 3"], sequence: Sequence) -> Bool[np.ndarray, "*batch"]:
    """Tell where the first and the third axis are within 10 degrees of each other, so that only their sum is known."""
    entry = np.clip(rotation[..., sequence[0], sequence[2]], -1.0, 1.0)
    return np.sqrt(1.0 - entry**2) < _LOCKED_SINE


def continuous(angle_rad: Float[np.ndarray, "frames 3"], is_proper: bool) -> Float[np.ndarray, "frames 3"]:
    """Angles that don't jump where rotations don't, and may therefore leave their principal ranges.

    Two triples of angles make the same rotation. Of sequences of three axes the one that is nearest to the frame before
    is taken, so that an arm that is raised aside and on overhead is abducted by more than 90 degrees; in the first
    frame the one with the smaller angles. Of sequences whose first and third axis are the same (``is_proper``) the
    second angle keeps its range. Frames with NaN stay NaN, and the next one is continuous with the last one before
    them.
    """
    known = np.isfinite(angle_rad).all(-1)
    found = angle_rad[known]
    if len(found) and not is_proper:
        other = np.stack([found[:, 0] + np.pi, np.pi - found[:, 1], found[:, 2] + np.pi], axis=-1)
        same = np.linalg.norm(_wrapped(np.diff(found, axis=0)), axis=-1)
        crossed = np.linalg.norm(_wrapped(other[1:] - found[:-1]), axis=-1)
        starts_other = np.linalg.norm(_wrapped(other[0])) < np.linalg.norm(found[0])
        is_other = np.logical_xor.accumulate(np.concatenate([[starts_other], crossed < same]))
        found = np.where(is_other[:, None], other, found)
        found[0] = _wrapped(found[0])
    unwrapped = np.full_like(angle_rad, np.nan)
    unwrapped[known] = np.unwrap(found, axis=0)
    return unwrapped


def _wrapped(angle_rad: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    return angle_rad - _FULL * np.round(angle_rad / _FULL)
