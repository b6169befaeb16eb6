"""Files for users of body models: NumPy reads them, and the model's kinematics lead to our joints."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.data.cameras import Timebase
from pipeline.core.joints import BODY_FEET
from pipeline.export.writers.body_npz import WRITER
from pipeline.export.writers.registry import PersonContent
from pipeline.motion.body.smplx_joints import JOINT_MAP, SMPLX_FROM_OURS, SMPLX_JOINTS
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics, rest_offsets_m
from tests.pipeline.export.character.takes import take_of


def test_poses_of_smplx_lead_to_our_joints(tmp_path: Path) -> None:
    animation = take_of("walk", "feet", 0.6)
    (track,), (motion,) = animation.tracks, animation.motions
    frames, skeleton_m = (
        range(motion.start_frame, motion.start_frame + len(motion.root_m) + 2),
        forward_kinematics(motion),
    )
    clock = Timebase(0.0, motion.frame_rate_hz, frames.stop)
    is_there = np.ones(len(frames), bool)
    unused: Any = None
    content = PersonContent(
        track,
        motion,
        BODY_FEET,
        clock,
        "person-1.npz",
        frames,
        is_there,
        np.zeros(3),
        "default",
        unused,
        lambda: skeleton_m,
        unused,
    )
    path = tmp_path / "person-1.npz"
    path.write_bytes(b"".join(WRITER.encode(content)))
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    assert (arrays["poses"].shape, arrays["betas"].shape) == ((len(frames), 165), (0,))
    assert arrays["mocap_frame_rate"] == motion.frame_rate_hz
    poses = arrays["poses"].reshape(len(frames), 55, 3)
    offsets = rest_offsets_m(motion.bone_length_m) @ SMPLX_FROM_OURS.T
    world, place_m = {}, {}
    for joint in SKELETON:
        name = JOINT_MAP.get(joint.name, (None,))[0]
        local = Rotation.from_rotvec(poses[:, SMPLX_JOINTS.index(name)]) if name else Rotation.identity(len(frames))
        if joint.parent is None:
            world[joint.name], place_m[joint.name] = local, arrays["trans"]
            continue
        above = world[joint.parent]
        world[joint.name] = above * local
        place_m[joint.name] = place_m[joint.parent] + above.apply(offsets[INDEX[joint.name]])
    for number, name in enumerate(arrays["joint_names"]):
        np.testing.assert_allclose(place_m[name], arrays["joints_m"][:, number], atol=1e-9, err_msg=name)
    np.testing.assert_allclose(arrays["joints_m"][: len(skeleton_m)], skeleton_m, atol=1e-12)
    np.testing.assert_array_equal(np.concatenate(list(WRITER.read(path, "default"))), arrays["joints_m"])
    heel = arrays["landmark_names"].tolist().index("left_heel")
    np.testing.assert_array_equal(
        arrays["landmarks_m"][: track.num_frames, heel], track.xyz_m[:, BODY_FEET.index("left_heel")]
    )
    assert np.isnan(arrays["landmarks_m"][-1]).all()
    named = dict(zip(arrays["joint_names"].tolist(), arrays["mhr_joints"].tolist(), strict=True))
    assert (named["LeftLeg"], named["LeftHandEnd"]) == ("l_lowleg", "")
