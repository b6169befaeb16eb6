"""Conventions of target software: names, axes, unit and rest pose of the skeleton in a file.

A preset never changes the motion: the positions of joints are the same in every preset.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.options.config import Preset
from pipeline.motion.body.joints import BODY_JOINTS, TwistJoint, twist_quat
from pipeline.motion.skeleton.model import INDEX, SkeletonJoint, find_skeleton, parent_indices, rest_offsets_m

_FINGERS = ("Index", "Middle", "Ring", "Pinky")
_BACKWARD = np.array([0.0, 1.0, 0.0])
# Joints of the arms before their hands' joints, and the sign of the rotation about ``_BACKWARD`` that lowers them.
_ARMS = {f"{side}{part}": sign for side, sign in (("Left", 1), ("Right", -1)) for part in ("Arm", "ForeArm", "Hand")}
WORLD = np.eye(3)
"""World axes: Z up, facing -Y in the rest pose."""

Y_UP_FROM_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Axes with Y up: x, y, z are the world's x, z, -y, and the rest pose faces +Z."""


def _lowering_sign(joint: SkeletonJoint) -> int:
    """Sign of the rotation that lowers a joint of an arm; 0 for other joints."""
    return next((sign for name, sign in _ARMS.items() if joint.name.startswith(name)), 0)


@dataclass(frozen=True, slots=True, eq=False)
class Convention:
    """Names, axes, unit and rest pose of the skeleton in a file."""

    # Names of joints that differ from ``pipeline.motion.skeleton.model``
    names: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    # Rotation from world axes to the file's axes; both are right-handed
    file_from_world: Float[np.ndarray, "3 3"] = field(default_factory=lambda: Y_UP_FROM_WORLD)
    units_per_m: float = 100.0  # Length of a metre in the file's unit
    is_order_demanded: bool = False  # True if software reads Z X Y alone; other files may have an order for each joint
    arms_lowered_deg: float = 0.0  # Angle by which the arms of the rest pose are lowered from a T-pose
    # Name of the node above the root in FBX files, where software expects one; else it has the person's name
    top: str | None = None
    has_rest_take: bool = False  # True if FBX files have the rest pose as an animation too

    def name(self, joint: str) -> str:
        """Name of a joint in the file."""
        return self.names.get(joint, joint)

    def file_from_xyz_m(self, xyz_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Convert world positions in metres to the file's axes and unit."""
        return xyz_m @ self.file_from_world.T * self.units_per_m

    def xyz_m_from_file(self, xyz: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Convert positions in the file to world positions in metres; inverse of ``file_from_xyz_m``."""
        return xyz / self.units_per_m @ self.file_from_world

    def rest_offsets(self, bone_length_m: Float[np.ndarray, " joints"]) -> Float[np.ndarray, "joints 3"]:
        """Offsets of all joints from their parents in the file's rest pose, axes and unit."""
        num_joints = len(bone_length_m)
        turned_m = self.lowered(num_joints)[parent_indices(num_joints)].apply(rest_offsets_m(bone_length_m))
        return self.file_from_xyz_m(turned_m)

    def parent_from_joint(
        self, quat_xyzw: Float[np.ndarray, "frames joints 4"]
    ) -> Float[np.ndarray, "frames joints 4"]:
        """Convert rotations (x, y, z, w) of a ``SkeletonMotion`` to the file's rest pose and axes.

        Continuous quaternions stay continuous.
        """
        turned = quat_xyzw.copy()
        num_joints = quat_xyzw.shape[1]
        lowered = self.lowered(num_joints)
        is_lowered = lowered.magnitude() > 0.0
        for index, parent in enumerate(parent_indices(num_joints)):
            if is_lowered[parent] or is_lowered[index]:
                turn = Rotation.from_quat(quat_xyzw[:, index])
                turned[:, index] = (lowered[parent] * turn * lowered[index].inv()).as_quat()
        return self.file_from_quat(turned)

    def twist_from_quat(
        self, quat_xyzw: Float[np.ndarray, "frames joints 4"], twist: TwistJoint
    ) -> Float[np.ndarray, "frames 4"]:
        """Rotations (x, y, z, w) of a twist joint in the file, from a ``SkeletonMotion``."""
        lowered = self.lowered(quat_xyzw.shape[1])[INDEX[twist.parent]]
        turn = Rotation.from_quat(twist_quat(quat_xyzw, twist))
        return self.file_from_quat((lowered * turn * lowered.inv()).as_quat())

    def file_from_quat(self, quat_xyzw: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4"]:
        """Convert rotations (x, y, z, w) to the file's axes; the rest pose is the skeleton's."""
        return np.concatenate([quat_xyzw[..., :3] @ self.file_from_world.T, quat_xyzw[..., 3:]], axis=-1)

    def lowered(self, num_joints: int) -> Rotation:
        """Rotation of each joint's bones from the T-pose to the rest pose, in world axes."""
        angle_rad = np.radians(self.arms_lowered_deg)
        signs = np.array([_lowering_sign(joint) for joint in find_skeleton(num_joints)])
        return Rotation.from_rotvec(angle_rad * signs[:, None] * _BACKWARD)


def _fingers(pattern: str, fingers: Mapping[str, str], parts: tuple[str, str, str]) -> dict[str, str]:
    """Patterns for ``_sided`` of the names of the fingers' joints, from the palm to the tip.

    ``pattern`` has ``{finger}`` and ``{part}``, and a side as in ``_sided``; ``fingers`` are names in the file by name
    in the skeleton, ``parts`` the names of the three joints of a finger.
    """
    return {
        f"{{Side}}Hand{finger}{number}": pattern.replace("{finger}", name).replace("{part}", part)
        for finger, name in fingers.items()
        for number, part in enumerate(parts, 1)
    }


def _numbered(chest: str, head_end: str = "HeadEnd", prefix: str = "") -> dict[str, str]:
    """Names of all joints where spines and the ends of fingers have numbers, and toes are joints."""
    names = {name: name.replace("3End", "4").replace("FootEnd", "ToeBase") for name in BODY_JOINTS}
    return {joint: prefix + name for joint, name in (names | {"Chest": chest, "HeadEnd": head_end}).items()}


def _sided(names: Mapping[str, str]) -> dict[str, str]:
    """Expand patterns to the names of both sides: ``{Side}`` is Left or Right, ``{s}`` is l or r, ``{S}`` is L or R."""
    return {
        joint.format(Side=side): name.format(Side=side, s=side[0].lower(), S=side[0])
        for joint, name in names.items()
        for side in ("Left", "Right")
    }


GLTF = Convention(units_per_m=1.0)
"""Convention of glTF: Y up, facing +Z, metres."""

PRESETS: Mapping[Preset, Convention] = MappingProxyType(
    {
        "default": Convention(),
        # Rigify's names. Blender's importer reads a unit as a metre, and its symmetry tools need sides as suffixes.
        "blender": Convention(
            names=_sided(
                {
                    "Hips": "hips",
                    "Spine": "spine",
                    "Chest": "chest",
                    "Neck": "neck",
                    "Head": "head",
                    "{Side}Shoulder": "shoulder.{S}",
                    "{Side}Arm": "upper_arm.{S}",
                    "{Side}ForeArm": "forearm.{S}",
                    "{Side}Hand": "hand.{S}",
                    "{Side}UpLeg": "thigh.{S}",
                    "{Side}Leg": "shin.{S}",
                    "{Side}Foot": "foot.{S}",
                    "{Side}FootEnd": "toe.{S}",
                    **{f"{{Side}}ForeArmTwist{number}": f"forearm_twist.0{number}.{{S}}" for number in (1, 2, 3)},
                    **_fingers(
                        "{finger}.{part}.{S}",
                        {"Thumb": "thumb"} | {finger: f"f_{finger.lower()}" for finger in _FINGERS},
                        ("01", "02", "03"),
                    ),
                }
            ),
            units_per_m=1.0,
        ),
        # Names of Unity's HumanBodyBones. Unity has no importer of its own; the loader of BVH Tools turns about axes in
        # one order, whatever the file's.
        "unity-humanoid": Convention(
            names=_sided(
                {
                    "{Side}Arm": "{Side}UpperArm",
                    "{Side}ForeArm": "{Side}LowerArm",
                    "{Side}UpLeg": "{Side}UpperLeg",
                    "{Side}Leg": "{Side}LowerLeg",
                    "{Side}FootEnd": "{Side}Toes",
                    **_fingers(
                        "{Side}{finger}{part}",
                        {finger: finger for finger in ("Thumb", *_FINGERS)} | {"Pinky": "Little"},
                        ("Proximal", "Intermediate", "Distal"),
                    ),
                }
            ),
            units_per_m=1.0,
            is_order_demanded=True,
        ),
        # Names that the mannequins Manny and Quinn, MetaHumans and the mannequin of Unreal Engine 4 have alike. Collar
        # bones are children of the third bone of the spine, in the later ones of the fifth.
        "unreal": Convention(
            names=_sided(
                {
                    "Hips": "pelvis",
                    "Spine": "spine_01",
                    "Chest": "spine_03",
                    "Neck": "neck_01",
                    "Head": "head",
                    "{Side}Shoulder": "clavicle_{s}",
                    "{Side}Arm": "upperarm_{s}",
                    "{Side}ForeArm": "lowerarm_{s}",
                    "{Side}Hand": "hand_{s}",
                    "{Side}UpLeg": "thigh_{s}",
                    "{Side}Leg": "calf_{s}",
                    "{Side}Foot": "foot_{s}",
                    "{Side}FootEnd": "ball_{s}",
                    # The first is that at the wrist.
                    **{f"{{Side}}ForeArmTwist{4 - number}": f"lowerarm_twist_0{number}_{{s}}" for number in (1, 2, 3)},
                    **_fingers(
                        "{finger}_{part}_{s}",
                        {finger: finger.lower() for finger in ("Thumb", *_FINGERS)},
                        ("01", "02", "03"),
                    ),
                }
            ),
            file_from_world=WORLD,
            arms_lowered_deg=45.0,
            top="root",
        ),
        # The collar bones are children of the third bone of the spine.
        "mixamo": Convention(
            names=_numbered("Spine2", "HeadTop_End", "mixamorig:"),
        ),
        # Names by which MotionBuilder and Maya characterise skeletons, standing in a T-pose.
        "humanik": Convention(names=_numbered("Spine1"), top="Reference", has_rest_take=True),
    }
)
