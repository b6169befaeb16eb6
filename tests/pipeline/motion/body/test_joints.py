from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.body.joints import TWIST_JOINTS, TwistJoint, twist_quat
from pipeline.motion.body.shape import BodyShapes, ShapedBody, shape_body, standing_ankle_m
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.fitting.fit import SkeletonFit
from pipeline.motion.skeleton.model import INDEX, forward_kinematics
from pipeline.validation.simulation.motion.performance import joints_at, perform
from pipeline.validation.simulation.motion.script import Role, Stay, Walk
from tests.acrobatics.acrobat import acrobat_joints_at, feet_on_floor, perform_acrobatics
from tests.acrobatics.motions import ACROBATICS
from tests.cases import slow_but
from tests.pipeline.motion.body.conftest import adult_lengths_m, in_pose
from tests.pipeline.motion.skeleton.hands.people import gesturing
from tests.pipeline.motion.skeleton.observed import observe, ring_of
from tests.pipeline.motion.skeleton.synthetic_tracks import timebase, track_of

_LIMBS = (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot"))


def still() -> np.ndarray:
    quat = np.zeros((64, 4))
    quat[:, 3] = 1.0
    return quat


def twists_of(body: ShapedBody, forearm: str) -> list[int]:
    """Twist joints of a forearm among a body's joints."""
    first = len(body.joints_m) - len(TWIST_JOINTS)
    return [number for number, twist in enumerate(TWIST_JOINTS, first) if twist.parent == forearm]


def bones_of(body: ShapedBody) -> list[tuple[str, int, int, np.ndarray, np.ndarray]]:
    """Limbs with the vertices around their middle, and around their end."""
    bones = []
    for side in ("Left", "Right"):
        for name, end in _LIMBS:
            joint, following = INDEX[f"{side}{name}"], INDEX[f"{side}{end}"]
            start_m, way_m = body.joints_m[joint], body.joints_m[following] - body.joints_m[joint]
            length_m = np.linalg.norm(way_m)
            along_m = (body.vertices_m - start_m) @ way_m / length_m
            apart_m = np.linalg.norm(body.vertices_m - start_m - along_m[:, None] * way_m / length_m, axis=-1)
            own = np.isin(body.carriers[:, 0], [joint, following, *twists_of(body, f"{side}{name}")])
            near = own & (apart_m < (0.12 if "Leg" in name else 0.08))
            middle, last = (near & (np.abs(along_m - place) < 0.015) for place in (0.5 * length_m, length_m))
            bones.append((f"{side}{name}", joint, following, middle, last))
    return bones


def assert_skin_follows(body: ShapedBody, motion: SkeletonMotion, step: int) -> None:
    positions_m = forward_kinematics(motion)
    bones = bones_of(body)
    assert all(middle.sum() > 8 and last.sum() > 8 for *_, middle, last in bones)
    for frame in range(0, len(positions_m), step):
        vertices_m, places_m = in_pose(body, motion.parent_from_joint[frame], motion.root_m[frame])
        np.testing.assert_allclose(places_m[: positions_m.shape[1]], positions_m[frame], atol=1e-9)
        for name, joint, following, middle, last in bones:
            ends = [joint, following]
            for skin, share in ((middle, 0.5), (last, 1.0)):
                rest_m = body.joints_m[ends].T @ [1.0 - share, share]
                here_m = places_m[ends].T @ [1.0 - share, share]
                at_rest_m = np.linalg.norm(body.vertices_m[skin].mean(0) - rest_m)
                distance_m = np.linalg.norm(vertices_m[skin].mean(0) - here_m)
                assert distance_m < at_rest_m + 0.01, (name, frame, share)


@pytest.mark.parametrize("name", slow_but(("cartwheel",), ACROBATICS))
def test_skin_follows_joints_of_acrobats(shapes: BodyShapes, name: str) -> None:
    part = ACROBATICS[name][0]
    acrobat = perform_acrobatics(part.keys, part.center_m, 0.3, 4.0, np.random.default_rng(2))
    truth_m = acrobat_joints_at(acrobat, np.arange(0.0, 4.0, 0.1), COCO_17)
    motion = SkeletonFit(track_of(truth_m), COCO_17, timebase(len(truth_m), 10.0), "person-1").motion()
    assert_skin_follows(shape_body(shapes, motion.bone_length_m), motion, step=2)


def test_skin_follows_joints_of_person_with_fingers(shapes: BodyShapes) -> None:
    motion = gesturing(60)
    assert_skin_follows(shape_body(shapes, motion.bone_length_m), motion, step=10)


def forearm_volumes(vertices_m: np.ndarray, body: ShapedBody, side: str) -> np.ndarray:
    """Volumes (m³) of twelve slices of a forearm that is along X: flow of the field (0, y, z) / 2 out of the skin."""
    elbow_m, wrist_m = body.joints_m[INDEX[f"{side}ForeArm"]], body.joints_m[INDEX[f"{side}Hand"]]
    shares = (body.vertices_m[:, 0] - elbow_m[0]) / (wrist_m[0] - elbow_m[0])
    inside = ((shares > 0.1) & (shares < 1.1))[body.triangles].all(1)
    triangles = body.triangles[inside]
    corners_m = vertices_m[triangles] - elbow_m
    facing = 0.5 * np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    flow = (facing[:, 1:] * corners_m.mean(1)[:, 1:]).sum(1)
    slices = np.floor((shares[triangles].mean(1) - 0.1) / 1.0 * 12.0).astype(int)
    return np.bincount(slices, flow, minlength=12)


@pytest.mark.parametrize("side", ["Left", "Right"])
@pytest.mark.parametrize(("twist_deg", "least"), [(30, 0.98), (-90, 0.95), (-180, 0.85)])
def test_forearm_keeps_its_volume_while_hand_turns(
    shapes: BodyShapes, side: str, twist_deg: float, least: float
) -> None:
    body = shape_body(shapes, adult_lengths_m())
    quat = still()
    rest = forearm_volumes(in_pose(body, quat, body.joints_m[0])[0], body, side)
    quat[INDEX[f"{side}Hand"]] = Rotation.from_euler("x", twist_deg, degrees=True).as_quat()
    turned = forearm_volumes(in_pose(body, quat, body.joints_m[0])[0], body, side)
    assert turned.sum() > least * rest.sum()
    assert (turned > 0.8 * rest).all()


@pytest.mark.parametrize("twist", TWIST_JOINTS, ids=lambda twist: twist.name)
def test_twist_joints_turn_by_share_of_hand(twist: TwistJoint) -> None:
    angles_deg = np.array([-230.0, -180.0, -90.0, 0.0, 80.0])
    quat = np.tile(still(), (len(angles_deg), 1, 1))
    bend = Rotation.from_euler("zy", [20.0, 35.0], degrees=True)
    turns = Rotation.from_euler("x", angles_deg[:, None], degrees=True)
    quat[:, INDEX[twist.hand]] = turns.as_quat()
    found = Rotation.from_quat(twist_quat(quat, twist))
    np.testing.assert_allclose(found.as_rotvec(degrees=True)[1:-1, 0], twist.share * angles_deg[1:-1], atol=1e-9)
    expected = Rotation.from_euler("x", twist.share * angles_deg[:, None], degrees=True)
    np.testing.assert_allclose((found * expected.inv()).magnitude(), 0.0, atol=1e-7)
    # The sign of quaternions does not matter, nor does a bend of the wrist.
    quat[:, INDEX[twist.hand]] = -(bend * turns).as_quat()
    bent = Rotation.from_quat(twist_quat(quat, twist))
    assert (np.degrees((bent * expected.inv()).magnitude()) < 20.0 * twist.share).all()


@pytest.mark.parametrize("seed", slow_but([6], [6, 3]))
def test_standing_feet_are_on_floor(shapes: BodyShapes, seed: int) -> None:
    role = Role((0.0, 0.0), 0.3, (Stay(1.5), Walk((1.5, 0.5)), Stay(2.0)))
    person = perform(role, 6.0, np.random.default_rng(seed), BODY_FEET)
    truth_m = joints_at(person, np.arange(150) / 25.0)
    cameras = ring_of(4)
    track, seen = observe(cameras, truth_m)
    animation = animate([track], [seen], cameras, timebase(150, 25.0), BODY_FEET, ReconstructionConfig())
    motion, floor = animation.motions[0], animation.floor
    assert floor is not None
    ankle_m = standing_ankle_m(motion, floor)
    body = shape_body(shapes, motion.bone_length_m, ankle_m)
    # Contacts are counted from the person's first frame. On a treadmill the floor tells nothing of the ankles' height.
    assert standing_ankle_m(replace(motion, start_frame=40), floor) == ankle_m
    assert standing_ankle_m(motion, replace(floor, z_m=floor.z_m - 0.25)) is None
    # Heels and toes have lain still for a fifth of a second, and will.
    is_flat = feet_on_floor(truth_m, 25.0)[..., :2].all(-1)
    is_standing = binary_erosion(is_flat, np.ones((11, 1), bool))
    heights_m = []
    for frame in range(0, 150, 3):
        vertices_m, _ = in_pose(body, motion.parent_from_joint[frame], motion.root_m[frame])
        for number, side in enumerate(("Left", "Right")):
            if is_standing[frame, number]:
                sole = body.carriers[:, 0] == INDEX[f"{side}Foot"]
                front = sole & (body.vertices_m[:, 1] < body.joints_m[INDEX[f"{side}Foot"], 1])
                heights_m += [floor.height_m(vertices_m[part]).min() for part in (front, sole & ~front)]
    assert len(heights_m) > 100
    assert np.abs(heights_m).max() < 0.005
