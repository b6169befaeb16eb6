"""Articulation of the skeleton for the fit: degrees of freedom, their limits, and landmarks on joints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.joints import JointSet
from pipeline.motion.skeleton.marks import part_of_mark
from pipeline.motion.skeleton.model import INDEX, SKELETON, rest_offsets_m

ARM_HINGES: Mapping[str, tuple[float, float, float]] = {"Left": (0.0, 0.0, -1.0), "Right": (0.0, 0.0, 1.0)}
"""Axes about which a positive rotation bends the elbow of a T-pose to the front."""
KNEE_HINGE = (1.0, 0.0, 0.0)
"""Axis about which a positive rotation bends a knee to the back."""

_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NUM_ROOT = 3
"""Number of the first degrees of freedom, the world position of the root."""


@dataclass(frozen=True, slots=True)
class Freedom:
    """Degree of freedom: a rotation about an axis that is fixed in a joint."""

    joints: tuple[str, ...]  # Names of one or two joints; two joints rotate by the same angle
    axis: tuple[float, float, float]  # Unit vector in the frame of the joint
    usual_rad: float = np.inf  # Standard deviation of the prior for the rest pose; infinite without a prior
    limits_rad: tuple[float, float] | None = None  # Smallest and largest angle of a hinge; ``None`` for other rotations
    rest_rad: float = 0.0  # Angle of a hinge in the prior; other rotations rest at 0
    usual_below_rad: float | None = None  # Standard deviation below the rest pose, if it is another

    def spread_rad(self, angle_rad: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
        """Standard deviation of the prior on the side of each angle from the rest pose."""
        return np.where(angle_rad < 0.0, self.usual_below_rad or self.usual_rad, self.usual_rad)


@dataclass(frozen=True, slots=True)
class Twist:
    """Twist of a ball joint about the bone to its child, which is not observable for a straight limb."""

    # Names of the ball joint and of the bone's end
    joint: str
    child: str
    limits_rad: tuple[float, float]  # Smallest and largest twist from the rest pose


def _ball(*joints: str, usual_rad: float = np.inf) -> tuple[Freedom, ...]:
    return tuple(Freedom(joints, axis, usual_rad) for axis in _AXES)


# Extremes of people: elbows and knees of flexible people go 12 degrees beyond straight; knees of people who sit on
# their heels bend to 165 degrees (Mulholland and Wyss 2001), elbows to the range of the American Academy of Orthopaedic
# Surgeons, rounded up.
_BEYOND_STRAIGHT_DEG, _ELBOW_DEG, _KNEE_DEG = -12.0, 155.0, 165.0


def _hinge(joint: str, axis: tuple[float, float, float], highest_deg: float) -> Freedom:
    return Freedom((joint,), axis, limits_rad=(np.radians(_BEYOND_STRAIGHT_DEG), np.radians(highest_deg)))


def _side(side: str) -> tuple[Freedom, ...]:
    return (
        *(Freedom((f"{side}Shoulder",), axis, 0.12) for axis in _AXES[1:]),
        *_ball(f"{side}Arm"),
        _hinge(f"{side}ForeArm", ARM_HINGES[side], _ELBOW_DEG),
        *_ball(f"{side}UpLeg"),
        _hinge(f"{side}Leg", KNEE_HINGE, _KNEE_DEG),
    )


FREEDOMS = (
    *_ball("Hips"),
    # The trunk bends evenly along the spine. The lines through hips and shoulders show how it bends aside and twists,
    # but not how it bends to the front or to the rear: there the largest extension, 20 to 30 degrees (American Academy
    # of Orthopaedic Surgeons), is two standard deviations of both joints together. More would let people who lean and
    # look ahead bend their backs to the rear as they bend their necks.
    Freedom(("Spine", "Chest"), _AXES[0], usual_rad=0.25, usual_below_rad=0.12),
    *(Freedom(("Spine", "Chest"), axis, usual_rad=0.25) for axis in _AXES[1:]),
    *_ball("Neck", usual_rad=0.35),
    *_ball("Head", usual_rad=0.5),
    *_side("Left"),
    *_side("Right"),
)
FEET = (*_ball("LeftFoot", usual_rad=0.5), *_ball("RightFoot", usual_rad=0.5))
"""Degrees of freedom of feet, used only if toes or heels are known."""

TWISTS = tuple(
    Twist(f"{side}{joint}", f"{side}{child}", (-np.radians(limit_deg), np.radians(limit_deg)))
    for side in ("Left", "Right")
    # An arm that is raised ahead and one that is raised aside meet overhead with half a turn between their twists: the
    # twist of an arm has nearly no limits of its own.
    for joint, child, limit_deg in (("Arm", "ForeArm", 150.0), ("UpLeg", "Leg", 55.0))
)

_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_FOOT = ("heel", "big_toe", "small_toe")


def joint_of_landmark(name: str) -> str | None:
    """Joint of the skeleton that carries a joint of the detector; ``None`` for an unknown joint."""
    if name in _FACE:
        return "Head"
    if name.endswith(_FOOT):
        return f"{name.partition('_')[0].capitalize()}Foot"
    middles = {"neck": "Neck", "mid_hip": "Hips"}
    return middles.get(name, _BY_LANDMARK.get(name))


_BY_LANDMARK = {joint.landmarks[0]: joint.name for joint in SKELETON if len(joint.landmarks) == 1}


class Carried(NamedTuple):
    """Landmark on a joint."""

    landmark: int  # Index of the landmark in the joint set of the detector
    joint: int  # Number of the joint that carries it
    offset_m: Float[np.ndarray, " 3"]  # Offset in the frame of the joint
    beside: bool  # True if the landmark may be off the joint's centre, so that the joint's own rotation moves it


@dataclass(frozen=True, slots=True, eq=False)
class Articulation:
    """A person's skeleton, or a part of it, as arrays for ``fit_kernels``."""

    freedoms: tuple[Freedom, ...]  # All rotations; the position of the root comes before them
    twists: tuple[Twist, ...]  # Ball joints whose twist has a prior of its own
    parent: Int[np.ndarray, " joints"]  # Number of each joint's parent, -1 for the root
    offset_m: Float[np.ndarray, "joints 3"]  # Offset of each joint from its parent, in the frame of the parent
    landmark: Int[np.ndarray, " landmarks"]  # Indices of the carried landmarks in the joint set of the detector
    # Joint that carries each landmark, and offset in the frame of the joint
    landmark_joint: Int[np.ndarray, " landmarks"]
    landmark_offset_m: Float[np.ndarray, "landmarks 3"]
    # Joints that each degree of freedom rotates (-1 for none), and the axis
    freedom_joint: Int[np.ndarray, "freedoms 2"]
    freedom_axis: Float[np.ndarray, "freedoms 3"]
    # Limits of hinges; infinite for other rotations
    lowest_rad: Float[np.ndarray, " freedoms"]
    highest_rad: Float[np.ndarray, " freedoms"]
    # Degrees of freedom that move each landmark, ascending and padded with -1, and their number
    moved_by: Int[np.ndarray, "landmarks most"]
    num_moved_by: Int[np.ndarray, " landmarks"]

    @property
    def num_freedoms(self) -> int:
        """Number of degrees of freedom, including the position of the root."""
        return NUM_ROOT + len(self.freedoms)


def articulate(
    bone_length_m: Float[np.ndarray, " joints"],
    joints: JointSet,
    offsets_m: Mapping[str, Float[np.ndarray, " 3"]],
    marks_m: Mapping[str, Float[np.ndarray, " 3"]] | None = None,
) -> Articulation:
    """Build the arrays of a person's skeleton.

    ``bone_length_m``: length of each bone of ``SKELETON``. ``joints``: joint set of the detector. ``offsets_m``:
    offsets of landmarks in head and feet, by name. Landmarks of head and feet without an offset are ignored. Feet can
    rotate only if a landmark of feet has an offset. ``marks_m``: offsets of the detector's marks from the centres of
    joints, by name; see ``skeleton.marks``. The landmarks are the marks. ``None``: no joint has one.
    """
    marks_m = marks_m or {}
    on_foot = [name for name in offsets_m if str(joint_of_landmark(name)).endswith("Foot")]
    freedoms = (*FREEDOMS, *(FEET if on_foot else ()))
    parent = np.array([-1 if joint.parent is None else INDEX[joint.parent] for joint in SKELETON])
    carried = {
        name: joint
        for name in joints.names
        if (joint := joint_of_landmark(name)) and (name in offsets_m or not (name in _FACE or name.endswith(_FOOT)))
    }
    rest_m = rest_offsets_m(bone_length_m)
    places = {name: (INDEX[joint], offsets_m.get(name, np.zeros(3))) for name, joint in carried.items()}
    for name in carried.keys() & marks_m.keys():
        centre, offset_m = places[name]
        part = INDEX[part_of_mark(name)]
        # A mark beside a joint moves with the part of the body that carries it: the joint itself or its parent.
        places[name] = part, marks_m[name] + offset_m + (rest_m[centre] if part != centre else 0.0)
    beside = offsets_m.keys() | marks_m.keys()
    landmarks = [Carried(joints.index(name), *place, name in beside) for name, place in places.items()]
    return build(INDEX, freedoms, TWISTS, parent, rest_m, landmarks)


def build(
    index: Mapping[str, int],
    freedoms: tuple[Freedom, ...],
    twists: tuple[Twist, ...],
    parent: Int[np.ndarray, " joints"],
    offset_m: Float[np.ndarray, "joints 3"],
    landmarks: Sequence[Carried],
) -> Articulation:
    """Build the arrays of any tree of joints.

    ``index`` is the number of each joint that the degrees of freedom name; ``parent`` and ``offset_m`` are the same as
    for ``Articulation``.
    """
    freedom_joint = np.full((NUM_ROOT + len(freedoms), 2), -1)
    for number, freedom in enumerate(freedoms, NUM_ROOT):
        freedom_joint[number, : len(freedom.joints)] = [index[name] for name in freedom.joints]
    turned = freedom_joint.tolist()
    moved_by = [_moved_by(landmark.joint, landmark.beside, parent, turned) for landmark in landmarks]
    most = max(map(len, moved_by), default=0)
    limits = [freedom.limits_rad or (-np.inf, np.inf) for freedom in freedoms]
    return Articulation(
        freedoms=freedoms,
        twists=twists,
        parent=parent,
        offset_m=offset_m,
        landmark=np.array([landmark.landmark for landmark in landmarks], dtype=int),
        landmark_joint=np.array([landmark.joint for landmark in landmarks], dtype=int),
        landmark_offset_m=np.array([landmark.offset_m for landmark in landmarks]).reshape(-1, 3),
        freedom_joint=freedom_joint,
        freedom_axis=np.array([*np.zeros((NUM_ROOT, 3)), *(freedom.axis for freedom in freedoms)]),
        lowest_rad=np.array([*[-np.inf] * NUM_ROOT, *(lowest for lowest, _ in limits)]),
        highest_rad=np.array([*[np.inf] * NUM_ROOT, *(highest for _, highest in limits)]),
        moved_by=np.array([[*moving, *[-1] * (most - len(moving))] for moving in moved_by], dtype=int).reshape(
            -1, most
        ),
        num_moved_by=np.array([len(moving) for moving in moved_by], dtype=int),
    )


def _moved_by(
    joint: int, beside: bool, parent: Int[np.ndarray, " joints"], freedom_joint: Sequence[Sequence[int]]
) -> list[int]:
    """Degrees of freedom that move a landmark at the centre of a joint, or ``beside`` it."""
    turning: set[int] = set()
    above = joint if beside else int(parent[joint])
    while above >= 0:
        turning.add(above)
        above = int(parent[above])
    # A skeleton is built for each of many lengths: sets of a few numbers are quicker than arrays.
    return [*range(NUM_ROOT), *(n for n, joints in enumerate(freedom_joint) if not turning.isdisjoint(joints))]
