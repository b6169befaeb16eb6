"""Joint rotations from a track's positions: bones of constant length, aimed at the joints.

From the hips outwards every bone is turned, by the smallest rotation, towards the measured position of its end, seen
from where the bones before it really end; so differences in length don't add up along a limb. Upper arms and thighs
are twisted so that elbows and knees work as hinges. What was not seen moves evenly from one known rotation to the next,
relative to its parent; what was never seen keeps its rest rotation. So do wrists and collar bones, of which positions
of joints say nothing, and ankles where neither toes nor heels are known. It is what the fit starts from.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.skeleton.fitting.articulation import ARM_HINGES, KNEE_HINGE
from pipeline.skeleton.landmarks import Landmarks
from pipeline.skeleton.model import INDEX, SKELETON, rest_offsets_m
from pipeline.skeleton.rigid_parts import solve_foot, solve_head
from pipeline.skeleton.rotations import continuous_quat_xyzw, filled, hinge_twist_rad, swing
from pipeline.skeleton.trunk import solve_torso

# A bone measured so much longer or shorter than it is, as a share of its length, was not measured: it isn't followed.
_MAX_STRETCH = 0.5


class _Pose:
    """A skeleton that is posed joint by joint, parents before children, in all frames at once."""

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
        """Where a joint is, as soon as its parent is posed."""
        parent = str(SKELETON[INDEX[name]].parent)
        return self._position_m[parent] + self._world_from_joint[parent].apply(self._offsets_m[INDEX[name]])

    def _believed(self, child: str, bone_m: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3"]:
        """A measured bone from its parent to ``child``, world axes; NaN where its length can't be true."""
        length_m = np.linalg.norm(self._offsets_m[INDEX[child]])
        stretch_m = np.abs(np.linalg.norm(bone_m, axis=-1) - length_m)
        return np.where(stretch_m[:, None] <= _MAX_STRETCH * length_m, bone_m, np.nan)

    def turn(self, name: str, parent_from_joint: Rotation) -> None:
        """Pose one joint."""
        self._position_m[name] = self.position_m(name)
        self._world_from_joint[name] = self.world_from_parent(name) * parent_from_joint
        self._parent_from_joint[name] = parent_from_joint

    def aim(self, name: str, child: str, target_m: Float[np.ndarray, "frames 3"], before: Rotation) -> None:
        """Pose a joint so that its child comes closest to a target, NaN where unknown.

        Parameters
        ----------
        before
            A rotation from the joint to its parent that the smallest rotation to the target follows.
        """
        bone_m = self._believed(child, target_m - self.position_m(name))
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

        Parameters
        ----------
        names
            Joints at the upper bone's start, at the hinge, and at the lower bone's end.
        joint_m, end_m
            Targets of the hinge (elbow, knee) and of the end (wrist, ankle), NaN where unknown.
        hinge
            Axis in the rest pose about which a positive rotation bends the limb.
        """
        upper, lower, end = names
        bone = self._directions[INDEX[lower]]
        world_from_parent = self.world_from_parent(upper)
        upper_m = self._believed(lower, joint_m - self.position_m(upper))
        turned, valid = swing(bone, world_from_parent.inv().apply(upper_m))
        lower_direction = (world_from_parent * turned).inv().apply(self._believed(end, end_m - joint_m))
        twist_rad = hinge_twist_rad(bone, hinge, lower_direction, frame_rate_hz)
        self.turn(upper, filled(turned * Rotation.from_rotvec(twist_rad[:, None] * bone), valid))
        self.aim(lower, end, end_m, Rotation.identity(len(end_m)))

    def parent_from_joint_xyzw(self) -> Float[np.ndarray, "frames joints 4"]:
        """Quaternions of all joints, continuous in time; the rest rotation for joints that nobody posed."""
        rest = Rotation.identity(len(self._position_m["Hips"]))
        return np.stack(
            [continuous_quat_xyzw(self._parent_from_joint.get(joint.name, rest)) for joint in SKELETON], axis=1
        )


def solve_pose(
    landmarks: Landmarks, bone_length_m: Float[np.ndarray, " joints"], frame_rate_hz: float
) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, "frames joints 4"]]:
    """Pose the skeleton of ``pipeline.skeleton.model`` by where landmarks are.

    Parameters
    ----------
    landmarks
        Positions with any gaps, at least one frame. They are looked up by COCO's names; the detector may know others,
        and need not know all.

    Returns
    -------
        World positions of the root and rotations of all joints to their parents (x, y, z, w), without any NaN. Joints
        that were not measured are filled in.
    """
    offsets_m = rest_offsets_m(bone_length_m)
    torso = solve_torso(landmarks, bone_length_m)
    head = solve_head(landmarks, torso)
    rest = Rotation.identity(len(torso.hips_m))

    pose = _Pose(bone_length_m, torso.hips_m, torso.world_from_pelvis)
    # The spine takes half of the twist between pelvis and chest, and ends where the chest has to begin.
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
