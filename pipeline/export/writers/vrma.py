"""VRMA files (glTF 2.0, binary, with the extension VRMC_vrm_animation 1.0): a motion for characters in VRM.

The skeleton is the same as in GLB files: its T-pose, which faces +Z and stands on the floor, is the rest pose that VRM
prescribes. The extension says which joints are the bones of a humanoid. Software turns the bones of a character as
these joints turn, and moves its hips as the root moves, in proportion to the height of the hips at rest.

A file has one person, without a body. Before and after the motion's own frames the nearest pose holds.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.export.presets import GLTF
from pipeline.export.writers.body_mesh import CAPSULES, body_at_rest
from pipeline.export.writers.glb import GlbDocument, GlbReader, positions_m
from pipeline.export.writers.registry import Writer
from pipeline.motion.skeleton.humanoid import UNITY_BONES
from pipeline.motion.skeleton.model import SKELETON, WHOLE_SKELETON, find_skeleton

EXTENSION = "VRMC_vrm_animation"
"""Name of the extension."""

_SPEC_VERSION = "1.0"
_THUMB = {"ThumbProximal": "ThumbMetacarpal", "ThumbIntermediate": "ThumbProximal"}


def _vrm_bone(unity_bone: str) -> str:
    side_bone = unity_bone[0].lower() + unity_bone[1:]
    return next((side_bone.replace(*names) for names in _THUMB.items() if names[0] in side_bone), side_bone)


HUMAN_BONES: Mapping[str, str] = MappingProxyType({joint: _vrm_bone(bone) for joint, bone in UNITY_BONES.items()})
"""Bone of a VRM humanoid by joint; ends of bones have none."""


def encode(motion: SkeletonMotion, origin_m: Float[np.ndarray, " 3"], frames: range | None = None) -> Iterator[bytes]:
    """Write a motion as VRMA, piece by piece. Equal motions give equal bytes.

    ``motion``: bone lengths (joints,) and path of the root (frames, 3) in metres, rotations (frames, joints, 4) as
    quaternions (x, y, z, w); all are finite. ``origin_m``: world position of the file's origin. ``frames``: output
    frames of the file; ``None``: the motion's frames. The nearest pose holds outside the motion's frames.

    >>> turns = np.tile([0.0, 0.0, 0.0, 1.0], (2, 24, 1))
    >>> motion = SkeletonMotion(1, "Anna", 0, 30.0, np.full(24, 0.3), np.zeros((2, 3)), turns, ())
    >>> b"VRMC_vrm_animation" in b"".join(encode(motion, np.zeros(3)))
    True
    """
    document = GlbDocument(origin_m, motion.frames if frames is None else frames, motion.frame_rate_hz)
    first_joint = document.add_skeleton(motion, body_at_rest(motion, GLTF, CAPSULES))
    document.animate(motion, first_joint)
    bones = {
        HUMAN_BONES[joint.name]: {"node": first_joint + index}
        for index, joint in enumerate(find_skeleton(len(motion.bone_length_m)))
        if joint.name in HUMAN_BONES
    }
    document.add_extension(EXTENSION, {"specVersion": _SPEC_VERSION, "humanoid": {"humanBones": bones}})
    yield from document.encode(motion.name)


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of a skeleton's joints from a file, block by block."""
    with path.open("rb") as file:
        reader = GlbReader(file)
        bones = reader.document["extensions"][EXTENSION]["humanoid"]["humanBones"]
        num_joints = len(WHOLE_SKELETON if HUMAN_BONES["LeftHandThumb1"] in bones else SKELETON)
        hips = bones[HUMAN_BONES["Hips"]]["node"]
        yield from positions_m(reader, range(hips, hips + num_joints))


WRITER = Writer(
    lambda person: encode(person.motion, person.origin_m, person.frames),
    lambda path, _: read_xyz_m(path),
    holds_name=True,
    has_origin=True,
)
