"""Corrected people: exact keys, unchanged frames, bones, contacts, and planted faults that are put right."""

import itertools

import numpy as np
import pytest

from pipeline.core.data.people import Source
from pipeline.core.options.edits import Contact, Correction, ExchangeSides, IgnoreDetections, KeyJoint, PlaceDetection
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from pipeline.validation.simulation.scenes import Joints
from tests.cases import slow_but
from tests.pipeline.motion.skeleton.corrections.faults import FaultyTake, Person, taken

# Half a second at the scene's rate of 25 frames a second.
REACH = 12


def key(take: FaultyTake, joint: str, row: int, by_m: tuple[float, float, float]) -> KeyJoint:
    track, _ = take.person
    x, y, z = track.xyz_m[row, take.index(joint)] + by_m
    return KeyJoint(person=1, joint=joint, frame=track.start_frame + row, place_m=(float(x), float(y), float(z)))


def true_key(take: FaultyTake, joint: str, row: int) -> KeyJoint:
    x, y, z = take.truth_m[row, take.index(joint)]
    return KeyJoint(person=1, joint=joint, frame=take.located.start_frame + row, place_m=(float(x), float(y), float(z)))


def assert_consistent(take: FaultyTake, person: Person) -> None:
    """Joints are where the skeleton has them, with the bones of the uncorrected person."""
    (track, motion), (_, before) = person, take.person
    posed_m = forward_kinematics(motion)
    for joint in SKELETON:
        if len(joint.landmarks) == 1:
            joint_m = track.xyz_m[:, take.index(joint.landmarks[0])]
            known = np.isfinite(joint_m).all(-1)
            np.testing.assert_allclose(joint_m[known], posed_m[known, INDEX[joint.name]], atol=1e-9)
    assert motion.bone_length_m.tolist() == before.bone_length_m.tolist()
    assert np.array_equal(np.isfinite(track.xyz_m).all(-1), track.source != Source.ABSENT)


@pytest.mark.parametrize("joints", slow_but(["body"], ["body", "feet", "whole"]))
@pytest.mark.parametrize("joint", ["left_elbow", "right_wrist", "left_ankle", "nose", "right_shoulder"])
def test_keyed_joint_is_at_its_place(joint: str, joints: Joints) -> None:
    take = taken(joints)
    (before, _), row = take.person, 60
    moved = key(take, joint, row, (0.1, 0.05, 0.1))
    track, motion = person = take.corrected([moved])
    assert np.linalg.norm(track.xyz_m[row, take.index(joint)] - moved.place_m) < 0.002
    for rows in (slice(None, row - REACH), slice(row + REACH + 1, None)):
        assert track.xyz_m[rows].tobytes() == before.xyz_m[rows].tobytes()
        assert motion.root_m[rows].tobytes() == take.person[1].root_m[rows].tobytes()
    assert_consistent(take, person)
    # 1 cm by hand, plus nothing at the key.
    assert track.uncertainty_m is not None
    assert track.uncertainty_m[row, take.index(joint)] == pytest.approx(0.01)
    # The joint follows smoothly: it moves by no more than 15 cm in half a second.
    off_m = np.linalg.norm(track.xyz_m - before.xyz_m, axis=-1)[:, take.index(joint)]
    assert np.abs(np.diff(off_m)).max() < 1.6 * 0.15 / REACH


def test_far_key_is_reached_with_whole_body() -> None:
    take = taken()
    for joint in ("right_wrist", "left_ankle", "nose"):
        moved = key(take, joint, 60, (0.0, 0.3, 0.0))
        track, _ = take.corrected([moved])
        assert np.linalg.norm(track.xyz_m[60, take.index(joint)] - moved.place_m) < 0.002


def test_keys_of_joint_are_joined_within_second() -> None:
    take = taken()
    elbow = take.index("left_elbow")
    keys = [key(take, "left_elbow", row, (0.0, 0.0, 0.1)) for row in (50, 60, 100)]
    track, _ = take.corrected(keys)
    off_m = (track.xyz_m - take.person[0].xyz_m)[:, elbow, 2]
    assert off_m[50:61] == pytest.approx(0.1, abs=0.002)
    assert off_m[80] == 0.0


def test_key_in_gap_ends_where_joint_is_seen() -> None:
    take = taken().seen_elsewhere("right_wrist", slice(80, 90), np.zeros(3), [])
    track, _ = take.corrected([true_key(take, "right_wrist", 85)])
    wrist = take.index("right_wrist")
    off_m = np.linalg.norm(track.xyz_m - take.person[0].xyz_m, axis=-1)[:, wrist]
    assert off_m[85] > 0.005
    assert off_m[:80].max() < 0.001 > off_m[90:].max()
    assert track.source[85, wrist] == Source.PREDICTED


def test_fingers_go_with_keyed_wrist() -> None:
    take = taken("whole")
    track, motion = take.corrected([key(take, "left_wrist", 60, (0.0, 0.0, 0.1))])
    before, _ = take.person
    tip, wrist = take.index("left_index_tip"), take.index("left_wrist")
    moved_m = (track.xyz_m - before.xyz_m)[60]
    assert moved_m[tip] == pytest.approx(moved_m[wrist], abs=1e-6)
    assert forward_kinematics(motion)[60, INDEX["LeftHand"]] == pytest.approx(track.xyz_m[60, wrist], abs=1e-9)


def test_exchanged_sides_are_put_right() -> None:
    clean, rows = taken(), slice(70, 82)
    take = clean.sides_exchanged(rows)
    fault_mm = take.error_mm(take.person[0], rows)
    frames = take.located.frames[rows]
    person = take.corrected([ExchangeSides(person=1, part="all", start_frame=frames.start, stop_frame=frames.stop)])
    assert fault_mm > 300.0
    assert take.error_mm(person[0], rows) < 1.1 * clean.error_mm(clean.person[0], rows)
    assert_consistent(take, person)
    assert len(person[1].contacts) == len(clean.person[1].contacts)


@pytest.mark.parametrize("by", ["ignoring", "keys"])
def test_wrong_elbow_is_put_right(by: str) -> None:
    clean, rows, off_m = taken(), slice(60, 68), np.array([0.09, 0.09, 0.08])
    take = clean.seen_elsewhere("left_elbow", rows, off_m, [0, 1])
    track, _ = take.person
    elbow, start = take.index("left_elbow"), track.start_frame
    assert np.linalg.norm(track.xyz_m[63, elbow] - take.truth_m[63, elbow]) > 0.10
    corrections: list[Correction] = [
        key(take, "left_elbow", 57, (0.0, 0.0, 0.0)),
        *(true_key(take, "left_elbow", row) for row in (60, 64, 67)),
        key(take, "left_elbow", 70, (0.0, 0.0, 0.0)),
    ]
    if by == "ignoring":
        cameras = [camera.name for camera in take.simulation.cameras[:2]]
        corrections = [
            IgnoreDetections(person=1, camera=name, part="left_arm", start_frame=start + 60, stop_frame=start + 68)
            for name in cameras
        ]
    assert take.error_mm(take.corrected(corrections)[0]) < 1.1 * clean.error_mm(clean.person[0])


def test_lost_wrist_is_put_right() -> None:
    clean, rows = taken(), slice(80, 95)
    take = clean.seen_elsewhere("right_wrist", rows, np.zeros(3), [])
    corrections = [true_key(take, "right_wrist", row) for row in (82, 85, 87, 89, 92)]
    corrected_mm = take.error_mm(take.corrected(corrections)[0], rows)
    assert take.error_mm(take.person[0], rows) > 1.2 * clean.error_mm(clean.person[0], rows)
    assert corrected_mm < 1.15 * clean.error_mm(clean.person[0], rows)
    assert take.error_mm(take.corrected(corrections)[0]) < 1.1 * clean.error_mm(clean.person[0])


def test_placed_detections_lead_joint_to_place() -> None:
    take = taken()
    start, column = take.located.start_frame, take.index("left_wrist")
    place_m = take.person[0].xyz_m[50, column] + (0.0, 0.1, 0.05)
    placed = []
    for camera in take.simulation.cameras[:3]:
        x, y = project(camera, place_m)
        placed.append(
            PlaceDetection(
                person=1, camera=camera.name, joint="left_wrist", frame=start + 50, place_px=(float(x), float(y))
            )
        )
    track, _ = take.corrected(placed)
    # The neighbours in time and the bones hold it back by a quarter of the way.
    assert np.linalg.norm(track.xyz_m[50, column] - place_m) < 0.03


def test_ignored_person_is_predicted() -> None:
    take = taken()
    start = take.located.start_frame
    ignored = [
        IgnoreDetections(person=1, camera=camera.name, part="all", start_frame=start + 50, stop_frame=start + 60)
        for camera in take.simulation.cameras
    ]
    track, motion = take.corrected(ignored)
    assert (track.source[50:60] == Source.PREDICTED).all()
    assert (track.views[50:60] == 0).all()
    assert np.isfinite(motion.root_m).all()


def test_added_contact_holds_foot_and_removed_frees_it() -> None:
    take = taken()
    _, before = take.person
    start = take.located.start_frame
    first, second = [contact for contact in before.contacts if contact.side == "left"][1:3]
    gap = Contact(
        person=1,
        limb="left_foot",
        start_frame=start + first.rows.stop,
        stop_frame=start + first.rows.stop + 5,
        stands=True,
    )
    track, motion = take.corrected([gap])
    held = track.xyz_m[first.rows.start : first.rows.stop + 5, take.index("left_ankle"), :2]
    assert np.ptp(held, axis=0).max() < 0.002
    longer = [contact for contact in motion.contacts if contact.side == "left"][1]
    assert (longer.start_frame, longer.num_frames) == (first.start_frame, first.num_frames + 5)
    none = Contact(
        person=1,
        limb="left_foot",
        start_frame=start + second.start_frame,
        stop_frame=start + second.rows.stop,
        stands=False,
    )
    assert len(take.corrected([none])[1].contacts) == len(before.contacts) - 1


def test_contact_of_hand_holds_wrist() -> None:
    take = taken()
    start = take.located.start_frame
    track, _ = take.corrected(
        [Contact(person=1, limb="right_hand", start_frame=start + 60, stop_frame=start + 70, stands=True)]
    )
    assert np.ptp(track.xyz_m[60:70, take.index("right_wrist")], axis=0).max() < 0.001


def test_order_of_independent_corrections_does_not_matter() -> None:
    take = taken()
    start = take.located.start_frame
    corrections: list[Correction] = [
        key(take, "left_wrist", 20, (0.1, 0.0, 0.0)),
        key(take, "right_knee", 30, (0.0, 0.05, 0.0)),
        ExchangeSides(person=1, part="arms", start_frame=start + 100, stop_frame=start + 110),
        Contact(person=1, limb="left_foot", start_frame=start + 60, stop_frame=start + 75, stands=True),
    ]
    expected_track, expected = take.corrected(corrections)
    for order in list(itertools.permutations(corrections))[5::9]:
        track, motion = take.corrected(order)
        assert track.xyz_m.tobytes() == expected_track.xyz_m.tobytes()
        assert motion.parent_from_joint.tobytes() == expected.parent_from_joint.tobytes()
        assert motion.contacts == expected.contacts


def test_corrections_elsewhere_change_nothing() -> None:
    take = taken()
    track, motion = take.corrected(
        [
            KeyJoint(person=1, joint="left_wrist", frame=100_000, place_m=(0.0, 0.0, 1.0)),
            KeyJoint(person=1, joint="left_index_tip", frame=take.located.start_frame, place_m=(0.0, 0.0, 1.0)),
            IgnoreDetections(person=1, camera="elsewhere", part="all", start_frame=0, stop_frame=50),
        ]
    )
    assert track.xyz_m.tobytes() == take.person[0].xyz_m.tobytes()
    assert motion.parent_from_joint.tobytes() == take.person[1].parent_from_joint.tobytes()
