"""Joint rotations from joint positions, with bones of constant length; the start of the fit.

From the hips outwards, each bone is turned by the smallest rotation towards the measured position of its end. It is
aimed from the position at which the previous bone ends in the skeleton, so that differences in length don't add up
along a limb. Upper arms and thighs are twisted so that elbows and knees are hinges. Unknown rotations are interpolated
between known rotations, relative to the parent. Joints that are never known keep their rest rotation. So do wrists and
collar bones, whose rotations don't follow from positions, and ankles if neither toes nor heels are known.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.fitting.articulation import ARM_HINGES, KNEE_HINGE
from pipeline.motion.skeleton.landmarks import Landmarks
from pipeline.motion.skeleton.model import INDEX, SKELETON, rest_offsets_m
from pipeline.motion.skeleton.rigid_parts import solve_foot, solve_head, solve_torso
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw, filled, hinge_twist_rad, swing

# Limit on the difference between measured and true length of a bone, as a share of its length; beyond it, the
# measurement is ignored.
_MAX_STRETCH = 0.5


class _Pose:
    """Skeleton that is posed joint by joint, parents before children, in all frames at once."""

    def __init__(
        self,
        bone_length_m: Float[np.ndarray, " joints"],
        root_m: Float[np.ndarray, "frames 3"],
        world_from_root: Rotation,
    ) -> None:
        self._directions = [np.array(joint.rest_direction) for joint in SKELETON]
        self._offsets_m = rest_offsets_m(bone_length_m)
        self._position_m = {"Hips": root_m}
        self._world_from_joint = {"Hips": world_from_root}
        self._parent_from_joint = {"Hips": world_from_root}

    def world_from_parent(self, name: str) -> Rotation:
        """Orientation of a joint's parent."""
        return self._world_from_joint[str(SKELETON[INDEX[name]].parent)]

    def position_m(self, name: str) -> Float[np.ndarray, "frames 3"]:
        """World position of a joint (metres); its parent must be posed."""
        parent = str(SKELETON[INDEX[name]].parent)
        return self._position_m[parent] + self._world_from_joint[parent].apply(self._offsets_m[INDEX[name]])

    def _plausible(self, child: str, bone_m: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3"]:
        """Vectors of a measured bone to ``child``, world axes; NaN where the length is not plausible."""
        length_m = np.linalg.norm(self._offsets_m[INDEX[child]])
        stretch_m = np.abs(np.linalg.norm(bone_m, axis=-1) - length_m)
        return np.where(stretch_m[:, None] <= _MAX_STRETCH * length_m, bone_m, np.nan)

    def turn(self, name: str, parent_from_joint: Rotation) -> None:
        """Pose a joint by its rotation to its parent."""
        self._position_m[name] = self.position_m(name)
        self._world_from_joint[name] = self.world_from_parent(name) * parent_from_joint
        self._parent_from_joint[name] = parent_from_joint

    def aim(self, name: str, child: str, target_m: Float[np.ndarray, "frames 3"], before: Rotation) -> None:
        """Pose a joint so that its child is closest to a target, NaN where unknown.

        ``before`` is the rotation from the joint to its parent before the smallest rotation to the target is applied.
        """
        bone_m = self._plausible(child, target_m - self.position_m(name))
        toward_m = (self.world_from_parent(name) * before).inv().apply(bone_m)
        turned, valid = swing(self._directions[INDEX[child]], toward_m)
        self.turn(name, filled(before * turned, valid))

    def aim_limb(
        self,
        names: tuple[str, str, str],
        joint_m: Float[np.ndarray, "frames 3"],
        end_m: Float[np.ndarray, "frames 3"],
        hinge: Float[np.ndarray, " 3"],
        frame_rate_hz: float,
    ) -> None:
        """Pose an arm or a leg: upper bone, hinge joint and lower bone.

        ``names``: joints at the upper bone's start, at the hinge, and at the lower bone's end. ``joint_m``, ``end_m``:
        targets of the hinge (elbow, knee) and of the end (wrist, ankle), NaN where unknown. ``hinge``: axis in the rest
        pose about which a positive rotation bends the limb.
        """
        upper, lower, end = names
        bone = self._directions[INDEX[lower]]
        world_from_parent = self.world_from_parent(upper)
        upper_m = self._plausible(lower, joint_m - self.position_m(upper))
        turned, valid = swing(bone, world_from_parent.inv().apply(upper_m))
        lower_direction = (world_from_parent * turned).inv().apply(self._plausible(end, end_m - joint_m))
        twist_rad = hinge_twist_rad(bone, hinge, lower_direction, frame_rate_hz)
        self.turn(upper, filled(turned * Rotation.from_rotvec(twist_rad[:, None] * bone), valid))
        self.aim(lower, end, end_m, Rotation.identity(len(end_m)))

    def parent_from_joint_xyzw(self) -> Float[np.ndarray, "frames joints 4"]:
        """Quaternions (x, y, z, w) of all joints, continuous in time; the identity for joints without a pose."""
        rest = Rotation.identity(len(self._position_m["Hips"]))
        return np.stack(
            [continuous_quat_xyzw(self._parent_from_joint.get(joint.name, rest)) for joint in SKELETON], axis=1
        )


def solve_pose(
    landmarks: Landmarks, bone_length_m: Float[np.ndarray, " joints"], frame_rate_hz: float
) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, "frames joints 4"]]:
    """Pose the skeleton of ``pipeline.motion.skeleton.model`` by landmarks.

    ``landmarks``: positions in at least one frame, with any gaps. Landmarks are looked up by the names of COCO; the
    detector may have other landmarks, and may lack some. Returns world positions of the root (metres) and rotations of
    all joints to their parents (x, y, z, w), without NaN: unknown joints are filled in.
    """
    offsets_m = rest_offsets_m(bone_length_m)
    torso = solve_torso(landmarks, bone_length_m)
    head = solve_head(landmarks, torso)
    rest = Rotation.identity(len(torso.hips_m))

    pose = _Pose(bone_length_m, torso.hips_m, torso.world_from_pelvis)
    # The spine takes half of the twist between pelvis and chest, and is aimed at the start of the chest.
    half_twist = (torso.world_from_pelvis.inv() * torso.world_from_chest) ** 0.5
    chest_m = torso.shoulders_m - torso.world_from_chest.apply(offsets_m[INDEX["Neck"]])
    pose.aim("Spine", "Chest", chest_m, half_twist)
    pose.turn("Chest", pose.world_from_parent("Chest").inv() * torso.world_from_chest)
    pose.aim("Neck", "Head", head.center_m, rest)
    pose.turn("Head", filled(pose.world_from_parent("Head").inv() * head.world_from_head, head.valid))
    for side, arm_hinge in ARM_HINGES.items():
        limb = side.lower()
        pose.turn(f"{side}Shoulder", rest)
        pose.aim_limb(
            (f"{side}Arm", f"{side}ForeArm", f"{side}Hand"),
            landmarks[f"{limb}_elbow"],
            landmarks[f"{limb}_wrist"],
            np.array(arm_hinge),
            frame_rate_hz,
        )
        pose.aim_limb(
            (f"{side}UpLeg", f"{side}Leg", f"{side}Foot"),
            landmarks[f"{limb}_knee"],
            landmarks[f"{limb}_ankle"],
            np.array(KNEE_HINGE),
            frame_rate_hz,
        )
        foot = solve_foot(landmarks, limb)
        pose.turn(f"{side}Foot", filled(pose.world_from_parent(f"{side}Foot").inv() * foot.world_from_foot, foot.valid))
    return torso.hips_m, pose.parent_from_joint_xyzw()
