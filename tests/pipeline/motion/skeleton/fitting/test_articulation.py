"""Degrees of freedom of the skeleton: derivatives against differences, hinges and limits."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.joints import BODY_25, COCO_17, JointSet
from pipeline.motion.skeleton.fitting import gauss_newton
from pipeline.motion.skeleton.fitting.articulation import NUM_ROOT, Articulation, articulate, joint_of_landmark
from pipeline.motion.skeleton.fitting.gauss_newton import JointPoses, landmark_positions, move, refine, start_from
from pipeline.motion.skeleton.model import INDEX, SKELETON

RATE_HZ = 25.0
LENGTHS_M = np.array([1.7 * joint.stature_share for joint in SKELETON])
STEP = 1e-6


def skeleton_of(joints: JointSet) -> Articulation:
    offsets_m = {
        name: np.array([0.02, -0.08, 0.01])
        for name in joints.names
        if joint_of_landmark(name) in {"Head", "LeftFoot", "RightFoot"} and not name.endswith("ankle")
    }
    return articulate(LENGTHS_M, joints, offsets_m)


def anybody(skeleton: Articulation, num_frames: int, seed: int = 0) -> JointPoses:
    rng = np.random.default_rng(seed)
    rotvec = rng.normal(0.0, 0.4, (num_frames, len(SKELETON), 3))
    quat = Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_quat().reshape(num_frames, len(SKELETON), 4)
    # The parts of the spine bend alike.
    quat[:, INDEX["Chest"]] = quat[:, INDEX["Spine"]]
    bodies = start_from(rng.normal(size=(num_frames, 3)), quat, skeleton)
    # Away from the ends of hinges, where steps are cut off.
    step = np.zeros((num_frames, skeleton.num_freedoms))
    step[:, np.isfinite(skeleton.lowest_rad)] = 0.2
    move(bodies, skeleton, step)
    return bodies


@pytest.mark.parametrize("joints", [COCO_17, BODY_25])
def test_jacobian_is_what_differences_say(joints: JointSet) -> None:
    skeleton = skeleton_of(joints)
    bodies = anybody(skeleton, 2)
    posed = gauss_newton.Posed(bodies, skeleton)
    jacobian = posed.jacobian()
    assert len(skeleton.landmark) == len(joints.names)
    for freedom in range(skeleton.num_freedoms):
        step = np.zeros((2, skeleton.num_freedoms))
        step[:, freedom] = STEP
        moved = JointPoses(bodies.root_m.copy(), bodies.local.copy(), bodies.angle_rad.copy())
        move(moved, skeleton, step)
        difference = (landmark_positions(moved, skeleton) - posed.landmark_m) / STEP
        for landmark in range(len(skeleton.landmark)):
            columns = skeleton.moved_by[landmark, : skeleton.num_moved_by[landmark]].tolist()
            said = jacobian[:, landmark, columns.index(freedom)] if freedom in columns else np.zeros((2, 3))
            np.testing.assert_allclose(difference[:, landmark], said, atol=1e-5)


def test_gradient_of_twist_is_what_differences_say() -> None:
    bone = np.array([0.0, 0.0, -1.0])
    rotation = Rotation.random(50, random_state=1)
    angle_rad, gradient = gauss_newton._twist(rotation.as_quat(), bone)
    clear = np.hypot(rotation.as_quat() @ [*bone, 0.0], rotation.as_quat()[:, 3]) > 0.3  # of a half turn of the bone
    for axis in np.eye(3):
        turned_rad, _ = gauss_newton._twist((rotation * Rotation.from_rotvec(STEP * axis)).as_quat(), bone)
        change = (turned_rad - angle_rad + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(change[clear] / STEP, (gradient @ axis)[clear], atol=1e-4)


class ObservedLandmarks:
    """Observed landmarks with a standard deviation of a centimetre."""

    def __init__(self, place_m: np.ndarray) -> None:
        self._place_m = place_m

    def normal_equations(self, landmark_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.broadcast_to(1e4 * np.eye(3), (*landmark_m.shape, 3)), 1e4 * (self._place_m - landmark_m)


def test_pose_is_found_again_from_one_near_by() -> None:
    skeleton = skeleton_of(BODY_25)
    truth = anybody(skeleton, 5)
    place_m = landmark_positions(truth, skeleton)
    rng = np.random.default_rng(2)
    move(truth, skeleton, rng.normal(0.0, 0.1, (5, skeleton.num_freedoms)))
    before_m = np.linalg.norm(landmark_positions(truth, skeleton) - place_m, axis=-1).mean()
    refine(truth, skeleton, ObservedLandmarks(place_m), np.full(len(skeleton.landmark), np.inf), RATE_HZ, 8)
    after_m = np.linalg.norm(landmark_positions(truth, skeleton) - place_m, axis=-1).mean()
    assert before_m > 0.05
    assert after_m < 0.01


@pytest.mark.parametrize(
    ("upper", "lower", "end"), [("LeftUpLeg", "LeftLeg", "LeftFoot"), ("RightArm", "RightForeArm", "RightHand")]
)
def test_hinge_that_is_pulled_backwards_stays_nearly_straight(upper: str, lower: str, end: str) -> None:
    """Observed shin bent ahead of the knee, and forearm bent behind the elbow."""
    skeleton = skeleton_of(COCO_17)
    rest = np.tile([0.0, 0.0, 0.0, 1.0], (4, len(SKELETON), 1))
    bodies = start_from(np.zeros((4, 3)), rest, skeleton)
    place_m = landmark_positions(bodies, skeleton)
    by_joint = {SKELETON[joint].name: number for number, joint in enumerate(skeleton.landmark_joint) if number >= 5}
    place_m[:, by_joint[end]] += [0.0, -0.15, 0.0] if end == "LeftFoot" else [0.0, 0.15, 0.0]
    refine(bodies, skeleton, ObservedLandmarks(place_m), np.full(len(skeleton.landmark), np.inf), RATE_HZ, 12)
    hinge = next(n for n, freedom in enumerate(skeleton.freedoms, NUM_ROOT) if freedom.joints == (lower,))
    np.testing.assert_allclose(bodies.angle_rad[:, hinge], np.radians(-12.0))
    bend = Rotation.from_matrix(bodies.local[:, INDEX[lower]]).as_rotvec() @ skeleton.freedom_axis[hinge]
    np.testing.assert_allclose(bend, bodies.angle_rad[:, hinge], atol=1e-9)


def test_landmark_moves_with_what_is_above_it_only() -> None:
    skeleton = skeleton_of(COCO_17)
    ankle = COCO_17.names.index("left_ankle")
    columns = skeleton.moved_by[ankle, : skeleton.num_moved_by[ankle]]
    turned = {name for column in columns[NUM_ROOT:] for name in skeleton.freedoms[column - NUM_ROOT].joints}
    assert turned == {"Hips", "LeftUpLeg", "LeftLeg"}


def test_feet_turn_only_where_toes_or_heels_are_seen() -> None:
    assert skeleton_of(BODY_25).num_freedoms == skeleton_of(COCO_17).num_freedoms + 6
