"""NPZ files for users of SMPL-X and MHR: our joint centres and rotations, without data of these models.

``poses`` are rotation vectors of the 55 joints of SMPL-X (frames, 165), ``trans`` the place of our hips, and ``betas``
is empty: the names are AMASS's, and the world has Z up. A model's shape, and its offset from the hips, are fitted by
``multicap bodies fit``. ``joint_names``, ``joints_m`` and ``world_from_joint`` (quaternions x, y, z, w) are our
skeleton; ``smplx_joints`` and ``mhr_joints`` name the joint of each, empty where there is none. ``landmarks_m`` are
points on the skin, NaN where unknown. Arrays have no pickles.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.runtime.npz import encode_arrays, open_archive
from pipeline.export.timelines import frame_blocks, held, unknown_outside
from pipeline.export.writers.registry import PersonContent, Writer
from pipeline.motion.body.smplx_joints import JOINT_MAP, SMPLX_JOINTS, smplx_poses
from pipeline.motion.skeleton.model import find_skeleton, posed_joints

LANDMARKS = ("nose", *(f"{side}_{point}" for point in ("ear", "heel", "big_toe") for side in ("left", "right")))
"""Joints of detectors that are points on the skin."""


def encode(person: PersonContent) -> Iterator[bytes]:
    """Write a person's file."""
    motion, frames = person.motion, person.frames
    rows = motion.frames
    names = [joint.name for joint in find_skeleton(len(motion.bone_length_m))]
    turns = np.stack(posed_joints(motion)[1], axis=1)
    quat = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat().reshape(*turns.shape[:2], 4)
    marks = [name for name in LANDMARKS if name in person.joints.names]
    landmarks_m = person.track.xyz_m[:, person.joints.indices(tuple(marks))]
    mapped = [JOINT_MAP.get(name, ("", "")) for name in names]
    yield encode_arrays(
        {
            "poses": held(smplx_poses(motion), rows, frames).reshape(len(frames), -1),
            "trans": held(motion.root_m[:, None], rows, frames)[:, 0],
            "betas": np.zeros(0),
            "gender": np.array("neutral"),
            "surface_model_type": np.array("smplx"),
            "mocap_frame_rate": np.array(person.timebase.frame_rate_hz),
            "frame": np.array(frames),
            "is_present": person.is_present,
            "pose_names": np.array(SMPLX_JOINTS),
            "joint_names": np.array(names),
            "smplx_joints": np.array([smplx for smplx, _ in mapped]),
            "mhr_joints": np.array([mhr for _, mhr in mapped]),
            "joints_m": held(person.skeleton_m(), rows, frames),
            "world_from_joint": held(quat, rows, frames),
            "landmark_names": np.array(marks),
            "landmarks_m": unknown_outside(landmarks_m, person.track.frames, frames),
        }
    )


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the skeleton's joints, block by block."""
    with open_archive(path) as archive:
        joints_m = archive["joints_m"]
    yield from (joints_m[rows] for rows in frame_blocks(len(joints_m)))


WRITER = Writer(encode, lambda path, _: read_xyz_m(path))
