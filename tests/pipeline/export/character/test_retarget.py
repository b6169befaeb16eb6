"""Motion on characters: standing feet, directions of limbs, hands that meet, fingers and twists."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Floor, FootContact, SkeletonMotion
from pipeline.export.character.character_files import angles_deg, retargeting_figures
from pipeline.export.character.figure import CharacterFigure, measure
from pipeline.export.character.gltf_reader import decode_character
from pipeline.export.character.mapping import map_bones
from pipeline.export.character.retarget import CharacterMotion, node_place, retarget
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from tests.pipeline.export.character.characters import bones_of, character, ik_bones, odd_bones, twin_bones, vrm
from tests.pipeline.export.character.takes import take_of
from tests.pipeline.export.character.test_mapping import Z_UP

CHARACTERS = ("default", "mixamo", "game_engine", "vrm 0.x", "vrm 1.0", "odd", "ik")
# Feet at the top, a hand below the hips, a hand below the chest.
IK_PARENTS = {"foot.L": None, "foot.R": None, "wrist.L": "root", "wrist.R": "spine01"}
TAKES = (
    *(("walk", "feet", 4.0), ("walk", "body", 4.0)),
    *(pytest.param(take, marks=pytest.mark.slow) for take in (("cartwheel", "body", 5.0), ("handstand", "body", 6.0))),
)

ON_THE_FLOOR = tuple(pytest.param((scene, "body", 20.0), marks=pytest.mark.slow) for scene in ("crawl", "lying"))


@cache
def figure(name: str) -> CharacterFigure:
    match name.split():
        case ["vrm", version]:
            content = vrm(version)
        case ["ik"]:
            content = character(ik_bones(IK_PARENTS), unit=100.0, turn=Z_UP)
        case ["odd"]:
            content = character(odd_bones(), unit=100.0, turn=Z_UP)
        case _:
            unit = 100.0 if name == "mixamo" else 1.0
            content = character(bones_of(name), unit=unit, armature_scale=1.0 / unit)
    file = decode_character(name, content)
    return measure(file, map_bones(file))


def twin(motion: SkeletonMotion) -> CharacterFigure:
    """Character with a person's bones."""
    content = character(twin_bones(motion.bone_length_m), sole=("LeftFoot", "RightFoot"))
    file = decode_character("twin.glb", content)
    return measure(file, map_bones(file))


def places(motion: CharacterMotion, joint: str) -> np.ndarray:
    """Places of a joint of a character in the person's metres."""
    return node_place(motion.figure, motion.hips, motion.turns, motion.figure.joints[joint]) / motion.scale


@pytest.mark.parametrize("name", CHARACTERS)
@pytest.mark.parametrize("take", [*TAKES, *ON_THE_FLOOR], ids=lambda take: "-".join(take[:2]))
def test_feet_stand_still_on_floor(name: str, take: tuple[str, str, float]) -> None:
    animation = take_of(*take)
    figures = retargeting_figures(retarget(animation.motions[0], figure(name), animation.floor))
    assert figures.slide_cm <= 0.1
    assert figures.penetration_cm <= 0.5
    assert figures.contacts_kept >= 0.98


@pytest.mark.parametrize("take", TAKES, ids=lambda take: "-".join(take[:2]))
def test_limbs_of_twin_have_person_s_directions(take: tuple[str, str, float]) -> None:
    animation = take_of(*take)
    motion = retarget(animation.motions[0], twin(animation.motions[0]), animation.floor)
    assert motion.scale == pytest.approx(1.0, abs=1e-5)
    figures = retargeting_figures(motion)
    assert figures.direction_deg[0] <= 0.5
    assert figures.direction_deg[1] <= 3.0


def test_hands_and_feet_below_other_bones_follow_limbs() -> None:
    animation = take_of("walk", "feet", 4.0)
    file = decode_character("whole.glb", character(bones_of("default"), unit=100.0, turn=Z_UP))
    whole = retarget(animation.motions[0], measure(file, map_bones(file)), animation.floor)
    ends = retarget(animation.motions[0], figure("ik"), animation.floor)
    for joint in ("LeftFoot", "RightToeBase", "LeftHand", "RightHandIndex3"):
        np.testing.assert_allclose(places(ends, joint), places(whole, joint), atol=1e-6)


@pytest.mark.parametrize("name", CHARACTERS)
def test_limbs_of_others_have_them_as_nearly_as_feet_allow(name: str) -> None:
    animation = take_of("walk", "feet", 4.0)
    motion = retarget(animation.motions[0], figure(name), animation.floor)
    assert retargeting_figures(motion).direction_deg[1] <= 3.0
    # Arms are free, so theirs are the person's.
    for side in ("Left", "Right"):
        assert angles_deg(motion, f"{side}Arm", f"{side}ForeArm").max() < 0.01
        assert angles_deg(motion, f"{side}ForeArm", f"{side}Hand").max() < 0.01


def test_feet_on_treadmill_go_with_its_belt() -> None:
    animation = take_of("walk", "feet", 4.0)
    source = animation.motions[0]
    # The person walks ahead at the speed of the belt, and so stays in the room.
    way_m = (source.root_m[-1] - source.root_m[0]) * [1.0, 1.0, 0.0] / (len(source.root_m) - 1)
    back_m = -np.arange(len(source.root_m))[:, None] * way_m
    straight = slice(0, 40)
    contacts = tuple(contact for contact in source.contacts if contact.rows.stop <= straight.stop)
    on_belt = replace(
        source,
        root_m=(source.root_m + back_m)[straight],
        parent_from_joint=source.parent_from_joint[straight],
        contacts=contacts,
    )
    motion = retarget(on_belt, figure("default"), animation.floor)
    np.testing.assert_allclose(motion.ground[-1] / motion.scale, back_m[straight.stop - 1], atol=0.05)
    figures = retargeting_figures(motion)
    assert figures.slide_cm <= 0.1
    assert figures.direction_deg[1] <= 5.0


def test_path_is_scaled_by_legs() -> None:
    animation = take_of("walk", "feet", 4.0)
    source = animation.motions[0]
    motion = retarget(source, figure("odd"), animation.floor)
    legs_m = source.bone_length_m[[INDEX["LeftLeg"], INDEX["LeftFoot"]]].sum()
    assert motion.scale == pytest.approx(figure("odd").leg_length / legs_m, rel=1e-3)
    middle_m = (places(motion, "LeftUpLeg") + places(motion, "RightUpLeg")) / 2
    # Hips shift a little for thighs and shins of other proportions.
    np.testing.assert_allclose(middle_m[:, :2], source.root_m[:, :2], atol=0.03)
    assert np.linalg.norm(np.diff(source.root_m[[0, 50], :2], axis=0)) > 1.0


def test_no_frame_jumps() -> None:
    """No joint moves from one frame to the next by 5 cm more than the person's."""
    for scene in ("walk", "cartwheel"):
        animation = take_of(scene, "body", 5.0)
        source = animation.motions[0]
        motion = retarget(source, figure("game_engine"), animation.floor)
        for joint in ("LeftLeg", "RightFoot", "LeftHand", "Head"):
            own = np.linalg.norm(np.diff(places(motion, joint), axis=0), axis=-1)
            person = np.linalg.norm(np.diff(forward_kinematics(source)[:, INDEX[joint]], axis=0), axis=-1)
            assert (own - person).max() < 0.05, (scene, joint)


def posed(turns_deg: dict[str, tuple[float, float, float]], num_frames: int = 3) -> SkeletonMotion:
    """Person who stands still in a pose, given by rotation vectors of joints."""
    lengths_m = np.array([joint.stature_share * 1.7 for joint in SKELETON])
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (num_frames, len(SKELETON), 1))
    for joint, vector in turns_deg.items():
        quat[:, INDEX[joint]] = Rotation.from_rotvec(np.radians(vector)).as_quat()
    root_m = np.tile([0.0, 0.0, 0.9], (num_frames, 1))
    return SkeletonMotion(1, "a", 0, 30.0, lengths_m, root_m, quat, ())


def standing(roll_deg: float) -> tuple[SkeletonMotion, Floor]:
    """Person with nearly straight legs whose feet stand at different heights, and a level floor halfway between."""
    roll, bend = (0.0, roll_deg, 0.0), 4.0
    turns_deg = {"Hips": roll, "Spine": (0.0, -roll_deg, 0.0)}
    for side in ("Left", "Right"):
        turns_deg |= {f"{side}UpLeg": (-bend, -roll_deg, 0.0), f"{side}Leg": (2 * bend, 0.0, 0.0)}
        turns_deg |= {f"{side}Foot": (-bend, 0.0, 0.0)}
    source = posed(turns_deg, 60)
    contacts = tuple(FootContact(side, 0, 60, 1.0, True, 0.0, 0.0) for side in ("left", "right"))
    ankles_m = forward_kinematics(source)[0, [INDEX["LeftFoot"], INDEX["RightFoot"]]]
    assert abs(ankles_m[0, 2] - ankles_m[1, 2]) > 0.005
    return replace(source, contacts=contacts), Floor(float(ankles_m[:, 2].mean()) - 0.065, 0.0, 0.0)


def test_hips_tilt_for_feet_that_were_located_beside_floor() -> None:
    """Nearly straight legs, which would turn by four degrees, keep their directions."""
    source, floor = standing(2.5)
    motion = retarget(source, twin(source), floor)
    for side in ("Left", "Right"):
        own, theirs = (places(motion, f"{side}Foot"), forward_kinematics(source)[:, INDEX[f"{side}Foot"]])
        assert 0.003 < abs(own[0, 2] - theirs[0, 2]) < 0.007
    figures = retargeting_figures(motion)
    assert figures.contacts_kept == 1.0
    assert figures.direction_deg[1] <= 1.5
    assert 2.0 <= figures.hips_deg[0] <= 2.6
    # The trunk stays upright, and nothing tilts without feet that stand.
    trunk = places(motion, "Head") - places(motion, "Hips")
    assert trunk[0, 2] / np.linalg.norm(trunk[0]) > 0.99
    assert retargeting_figures(retarget(replace(source, contacts=()), twin(source), floor)).hips_deg[1] < 1e-6


def test_hips_do_not_rock_while_foot_stands() -> None:
    """Hips are as smooth as the person's where feet stand still."""
    animation = take_of("walk", "feet", 4.0)
    source = animation.motions[0]
    motion = retarget(source, figure("default"), animation.floor)
    own, theirs = (np.diff(root, 2, axis=0) for root in (motion.hips / motion.scale, source.root_m))
    assert np.sqrt((own**2).sum(-1).mean()) <= 1.1 * np.sqrt((theirs**2).sum(-1).mean())


def test_hands_meet_where_they_met() -> None:
    bent = {"LeftArm": -80.0, "RightArm": 80.0, "LeftForeArm": -70.0, "RightForeArm": 70.0}
    source = posed({joint: (0.0, 0.0, deg) for joint, deg in bent.items()})
    wrists_m = forward_kinematics(source)[:, [INDEX["LeftHand"], INDEX["RightHand"]]]
    apart_m = wrists_m[:, 0] - wrists_m[:, 1]
    assert np.linalg.norm(apart_m[0]) < 0.15
    motion = retarget(source, figure("odd"), None)
    own_m = places(motion, "LeftHand") - places(motion, "RightHand")
    np.testing.assert_allclose(own_m, apart_m, atol=1e-3)
    # Hands that are apart keep their arms' directions instead.
    apart = retarget(posed({}), figure("odd"), None)
    assert angles_deg(apart, "LeftArm", "LeftHand").max() < 1e-3


def test_person_at_rest_stands_straight() -> None:
    """An A-posed character in a person's T-pose has its arms and legs stretched, and its hands flat."""
    motion = retarget(posed({}), figure("default"), None)
    for side, out in (("Left", 1.0), ("Right", -1.0)):
        arm = places(motion, f"{side}Hand") - places(motion, f"{side}Arm")
        np.testing.assert_allclose(arm / np.linalg.norm(arm, axis=-1, keepdims=True), [[out, 0, 0]] * 3, atol=1e-5)
        palm = places(motion, f"{side}HandIndex1") - places(motion, f"{side}HandPinky1")
        assert (palm[:, 1] < 0).all()
        assert (np.abs(palm[:, 2]) < np.abs(palm[:, 1])).all()


@pytest.mark.slow
def test_fingers_turn_as_person_s() -> None:
    animation = take_of("hands", "whole", 4.0)
    source = animation.motions[0]
    motion = retarget(source, figure("mixamo"), animation.floor)
    person_m = forward_kinematics(source)
    for finger in ("Thumb", "Index", "Pinky"):
        start, end = f"RightHand{finger}1", f"RightHand{finger}2"
        own = places(motion, end) - places(motion, start)
        theirs = person_m[:, INDEX[end]] - person_m[:, INDEX[start]]
        cosine = (own * theirs).sum(-1) / np.linalg.norm(own, axis=-1) / np.linalg.norm(theirs, axis=-1)
        assert np.degrees(np.arccos(cosine.min())) < 1.0
    # Without fingers in the take they stay as they are in the hand.
    still = retarget(
        replace(source, bone_length_m=source.bone_length_m[:24], parent_from_joint=source.parent_from_joint[:, :24]),
        figure("mixamo"),
        None,
    )
    assert figure("mixamo").joints["LeftHandIndex1"] not in still.turns


def test_bones_of_forearm_share_twist_of_hand() -> None:
    rig, joints = figure("default").rig, figure("default").joints
    motion = retarget(posed({"LeftHand": (60.0, 0.0, 0.0)}), figure("default"), None)
    turns = motion.turns
    elbow, hand, between = joints["LeftForeArm"], joints["LeftHand"], rig.names.index("lowerarm02.L")
    still = retarget(posed({}), figure("default"), None).turns

    def twisted_deg(node: int) -> float:
        return float(np.degrees(Rotation.from_matrix(turns[node][0] @ still[node][0].T).magnitude()))

    assert twisted_deg(elbow) == pytest.approx(0.0, abs=1e-6)
    assert twisted_deg(hand) == pytest.approx(60.0, abs=1e-6)
    assert 15.0 < twisted_deg(between) < 45.0
