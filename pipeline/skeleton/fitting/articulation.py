"""The skeleton as the fit turns it: its degrees of freedom, their limits, and the landmarks that hang on its joints."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.joints import JointSet
from pipeline.skeleton.model import INDEX, SKELETON, rest_offsets_m

ARM_HINGES: Mapping[str, tuple[float, float, float]] = {"Left": (0.0, 0.0, -1.0), "Right": (0.0, 0.0, 1.0)}
"""Axes about which a positive rotation bends an elbow of the T-pose, to the front."""
KNEE_HINGE = (1.0, 0.0, 0.0)
"""Axis about which a positive rotation bends a knee, to the back."""

_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NUM_ROOT = 3
"""The first degrees of freedom: the root's place in the world."""


@dataclass(frozen=True, slots=True)
class Freedom:
    """A rotation about an axis that is fixed in a joint.

    Parameters
    ----------
    joints
        Names of what turns; where they are two, both turn by the same angle.
    axis
        Unit vector, in the joint.
    usual_rad
        How far from rest it usually is. What observations don't say is drawn to rest with this standard deviation;
        infinite where nothing is drawn.
    limits_rad
        Angles that a hinge can have.
    """

    joints: tuple[str, ...]
    axis: tuple[float, float, float]
    usual_rad: float = np.inf
    limits_rad: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Twist:
    """The twist of a ball joint about the bone that hangs on it, which a straight limb does not show.

    Parameters
    ----------
    joint, child
        Names of the ball joint and of the bone's end.
    limits_rad
        How far it can be twisted from rest.
    """

    joint: str
    child: str
    limits_rad: tuple[float, float]


def _ball(*joints: str, usual_rad: float = np.inf) -> tuple[Freedom, ...]:
    return tuple(Freedom(joints, axis, usual_rad) for axis in _AXES)


def _side(side: str) -> tuple[Freedom, ...]:
    # Ranges after the American Academy of Orthopaedic Surgeons, rounded up; without hyperextension, which detectors'
    # noise can't be told from.
    return (
        *(Freedom((f"{side}Shoulder",), axis, 0.12) for axis in _AXES[1:]),
        *_ball(f"{side}Arm"),
        Freedom((f"{side}ForeArm",), ARM_HINGES[side], limits_rad=(0.0, np.radians(155.0))),
        *_ball(f"{side}UpLeg"),
        Freedom((f"{side}Leg",), KNEE_HINGE, limits_rad=(0.0, np.radians(155.0))),
    )


FREEDOMS = (
    *_ball("Hips"),
    # The trunk bends evenly along the spine.
    *_ball("Spine", "Chest", usual_rad=0.25),
    *_ball("Neck", usual_rad=0.35),
    *_ball("Head", usual_rad=0.5),
    *_side("Left"),
    *_side("Right"),
)
FEET = (*_ball("LeftFoot", usual_rad=0.5), *_ball("RightFoot", usual_rad=0.5))
"""Only where toes or heels are seen."""

TWISTS = tuple(
    Twist(f"{side}{joint}", f"{side}{child}", (-np.radians(limit_deg), np.radians(limit_deg)))
    for side in ("Left", "Right")
    for joint, child, limit_deg in (("Arm", "ForeArm", 110.0), ("UpLeg", "Leg", 55.0))
)

_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_FOOT = ("heel", "big_toe", "small_toe")


def joint_of_landmark(name: str) -> str | None:
    """The skeleton's joint that carries a detector's joint; ``None`` for one that it doesn't know."""
    if name in _FACE:
        return "Head"
    if name.endswith(_FOOT):
        return f"{name.partition('_')[0].capitalize()}Foot"
    middles = {"neck": "Neck", "mid_hip": "Hips"}
    return middles.get(name, _BY_LANDMARK.get(name))


_BY_LANDMARK = {joint.landmarks[0]: joint.name for joint in SKELETON if len(joint.landmarks) == 1}


@dataclass(frozen=True, slots=True, eq=False)
class Articulation:
    """A person's skeleton as arrays, for ``articulation_kernels``.

    Parameters
    ----------
    freedoms
        All rotations; the root's place comes before them.
    parent
        Number of each joint's parent, -1 for the root.
    offset_m
        Of each joint from its parent, in the parent.
    landmark
        Numbers on the detector's joint axis of the landmarks that the skeleton carries.
    landmark_joint, landmark_offset_m
        The joint that carries each, and where in it.
    freedom_joint, freedom_axis
        What each degree of freedom turns (-1 for nothing), and about which axis.
    lowest_rad, highest_rad
        Ends of hinges; infinite for other rotations.
    moved_by, num_moved_by
        The degrees of freedom that move each landmark, ascending, and how many they are.
    """

    freedoms: tuple[Freedom, ...]
    parent: Int[np.ndarray, " joints"]
    offset_m: Float[np.ndarray, "joints 3"]
    landmark: Int[np.ndarray, " landmarks"]
    landmark_joint: Int[np.ndarray, " landmarks"]
    landmark_offset_m: Float[np.ndarray, "landmarks 3"]
    freedom_joint: Int[np.ndarray, "freedoms 2"]
    freedom_axis: Float[np.ndarray, "freedoms 3"]
    lowest_rad: Float[np.ndarray, " freedoms"]
    highest_rad: Float[np.ndarray, " freedoms"]
    moved_by: Int[np.ndarray, "landmarks most"]
    num_moved_by: Int[np.ndarray, " landmarks"]

    @property
    def num_freedoms(self) -> int:
        """With the root's place."""
        return NUM_ROOT + len(self.freedoms)


def articulate(
    bone_length_m: Float[np.ndarray, " joints"],
    joints: JointSet,
    offsets_m: Mapping[str, Float[np.ndarray, " 3"]],
) -> Articulation:
    """Lay out a person's skeleton.

    Parameters
    ----------
    joints
        The detector's.
    offsets_m
        Where landmarks of face and feet lie in head and feet; feet turn if one of theirs is among them. A landmark of
        head or feet that is not among them is not carried.
    """
    on_foot = [name for name in offsets_m if str(joint_of_landmark(name)).endswith("Foot")]
    freedoms = (*FREEDOMS, *(FEET if on_foot else ()))
    parent = np.array([-1 if joint.parent is None else INDEX[joint.parent] for joint in SKELETON])
    carried = {
        name: joint
        for name in joints.names
        if (joint := joint_of_landmark(name)) and (name in offsets_m or not (name in _FACE or name.endswith(_FOOT)))
    }
    freedom_joint = np.full((NUM_ROOT + len(freedoms), 2), -1)
    for number, freedom in enumerate(freedoms, NUM_ROOT):
        freedom_joint[number, : len(freedom.joints)] = [INDEX[name] for name in freedom.joints]
    moved_by = [_moved_by(INDEX[joint], name in offsets_m, parent, freedom_joint) for name, joint in carried.items()]
    most = max(map(len, moved_by), default=0)
    limits = [freedom.limits_rad or (-np.inf, np.inf) for freedom in freedoms]
    return Articulation(
        freedoms=freedoms,
        parent=parent,
        offset_m=rest_offsets_m(bone_length_m),
        landmark=np.array(joints.indices(tuple(carried)), dtype=int),
        landmark_joint=np.array([INDEX[joint] for joint in carried.values()], dtype=int),
        landmark_offset_m=np.array([offsets_m.get(name, np.zeros(3)) for name in carried]).reshape(-1, 3),
        freedom_joint=freedom_joint,
        freedom_axis=np.array([*np.zeros((NUM_ROOT, 3)), *(freedom.axis for freedom in freedoms)]),
        lowest_rad=np.array([*[-np.inf] * NUM_ROOT, *(lowest for lowest, _ in limits)]),
        highest_rad=np.array([*[np.inf] * NUM_ROOT, *(highest for _, highest in limits)]),
        moved_by=np.array([[*one, *[-1] * (most - len(one))] for one in moved_by], dtype=int).reshape(-1, most),
        num_moved_by=np.array([len(one) for one in moved_by], dtype=int),
    )


def _moved_by(
    joint: int, beside: bool, parent: Int[np.ndarray, " joints"], freedom_joint: Int[np.ndarray, "freedoms 2"]
) -> list[int]:
    """Degrees of freedom that move a landmark at a joint, or ``beside`` it."""
    turning: set[int] = set()
    above = joint if beside else int(parent[joint])
    while above >= 0:
        turning.add(above)
        above = int(parent[above])
    return [*range(NUM_ROOT), *np.flatnonzero(np.isin(freedom_joint, list(turning)).any(1)).tolist()]
