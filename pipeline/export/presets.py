"""How files name, turn and scale the skeleton for the software that is to open them.

A preset changes the mapping and never the motion: in every one of them each joint is where the skeleton has it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.config import Preset
from pipeline.export.writers.axes import WORLD, Y_UP_FROM_WORLD
from pipeline.skeleton.model import INDEX, SKELETON, rest_offsets_m

_PARENTS = [INDEX[joint.parent] if joint.parent else 0 for joint in SKELETON]
_BACKWARD = np.array([0.0, 1.0, 0.0])
# Joints that a lowered arm carries, and about which direction of ``_BACKWARD`` it is lowered.
_ARMS = {
    f"{side}{part}": sign
    for side, sign in (("Left", 1), ("Right", -1))
    for part in ("Arm", "ForeArm", "Hand", "HandEnd")
}


@dataclass(frozen=True, slots=True, eq=False)
class Convention:
    """Names, axes, unit and rest pose of the skeleton in a file.

    Parameters
    ----------
    names
        Of joints that are called other than in ``pipeline.skeleton.model``.
    file_from_world
        Rotation to the file's axes, right-handed as the world's.
    units_per_m
        How many of the file's units a metre is.
    rotation_order
        Axes of the intrinsic rotations that Euler angles stand for.
    arms_lowered_deg
        How far the rest pose's arms are below those of a T-pose.
    """

    names: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    file_from_world: Float[np.ndarray, "3 3"] = field(default_factory=lambda: Y_UP_FROM_WORLD)
    units_per_m: float = 100.0
    rotation_order: str = "ZXY"
    arms_lowered_deg: float = 0.0

    def name(self, joint: str) -> str:
        """What the file calls a joint."""
        return self.names.get(joint, joint)

    def file_from_xyz_m(self, xyz_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Places in the world, in metres, on the file's axes and in its unit."""
        return xyz_m @ self.file_from_world.T * self.units_per_m

    def xyz_m_from_file(self, xyz: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Undo ``file_from_xyz_m``."""
        return xyz / self.units_per_m @ self.file_from_world

    def rest_offsets(self, bone_length_m: Float[np.ndarray, " joints"]) -> Float[np.ndarray, "joints 3"]:
        """Offsets of all joints from their parents in the file's rest pose."""
        turned_m = self._lowered()[_PARENTS].apply(rest_offsets_m(bone_length_m))
        return self.file_from_xyz_m(turned_m)

    def parent_from_joint(
        self, quat_xyzw: Float[np.ndarray, "frames joints 4"]
    ) -> Float[np.ndarray, "frames joints 4"]:
        """Rotations of a ``SkeletonMotion`` as they are from the file's rest pose, on its axes; as continuous."""
        turned = quat_xyzw.copy()
        lowered = self._lowered()
        for index, parent in enumerate(_PARENTS):
            if (lowered[[parent, index]].magnitude() > 0.0).any():
                turn = Rotation.from_quat(quat_xyzw[:, index])
                turned[:, index] = (lowered[parent] * turn * lowered[index].inv()).as_quat()
        turned[..., :3] = turned[..., :3] @ self.file_from_world.T
        return turned

    def _lowered(self) -> Rotation:
        """Rotation of every joint's bones from the T-pose to the rest pose, world axes."""
        angle_rad = np.radians(self.arms_lowered_deg)
        signs = np.array([_ARMS.get(joint.name, 0) for joint in SKELETON])
        return Rotation.from_rotvec(angle_rad * signs[:, None] * _BACKWARD)


def _sided(names: Mapping[str, str]) -> dict[str, str]:
    """Names of both sides from patterns, ``{Side}`` and ``{s}`` in the places of left or right."""
    return {
        joint.format(Side=side): name.format(Side=side, s=side[0].lower(), S=side[0])
        for joint, name in names.items()
        for side in ("Left", "Right")
    }


GLTF = Convention(units_per_m=1.0)
"""What glTF prescribes: Y up, facing +Z, metres."""

PRESETS: Mapping[Preset, Convention] = MappingProxyType(
    {
        "default": Convention(),
        # The importer takes a unit for a metre; sides as suffixes are what its symmetry tools go by. Rigify's names.
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
                }
            ),
            units_per_m=1.0,
        ),
        # Names of HumanBodyBones.
        "unity-humanoid": Convention(
            names=_sided(
                {
                    "{Side}Arm": "{Side}UpperArm",
                    "{Side}ForeArm": "{Side}LowerArm",
                    "{Side}UpLeg": "{Side}UpperLeg",
                    "{Side}Leg": "{Side}LowerLeg",
                }
            ),
            units_per_m=1.0,
        ),
        # The mannequin's names; collar bones hang on its third bone of the spine.
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
                }
            ),
            file_from_world=WORLD,
            # About the same axes of the body as Z X Y where Y is up.
            rotation_order="YXZ",
            arms_lowered_deg=45.0,
        ),
        # Collar bones hang on the third bone of the spine here too.
        "mixamo": Convention(
            names={joint.name: f"mixamorig:{'Spine2' if joint.name == 'Chest' else joint.name}" for joint in SKELETON},
        ),
    }
)
