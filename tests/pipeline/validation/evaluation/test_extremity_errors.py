"""Errors of feet and hands on simulated people."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Side, SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import COCO_17, WHOLE_BODY, finger_joints
from pipeline.motion.skeleton.model import INDEX, SKELETON, joint_pose
from pipeline.validation.evaluation.extremity_errors import (
    bends_deg,
    count_backward_bends,
    heading_error_deg,
    pitch_deg,
    score_foot_directions,
    score_hands,
    score_heels_and_toes,
)
from pipeline.validation.simulation.motion.hands import ANGLES, DIP_SHARE, Hands, fingers
from pipeline.validation.simulation.scenes import SCENES, Simulation, record

WALK = record(replace(SCENES["walk"], duration_s=3.0), 1, 2, "feet")


def tracks_of(simulation: Simulation, move_m: np.ndarray) -> list[Track3D]:
    """Tracks of the truth in reversed order, with moved joints."""
    tracks = []
    for number, xyz_m in enumerate(simulation.truth_m[::-1]):
        shape = xyz_m.shape[:2]
        tracks.append(
            Track3D(
                number + 1,
                0,
                xyz_m + move_m,
                np.ones(shape),
                np.full(shape, Source.MEASURED),
                np.zeros(shape),
                np.full(shape, 2),
            )
        )
    return tracks


def test_truth_has_no_error() -> None:
    scores = score_heels_and_toes(tracks_of(WALK, np.zeros((21, 3))), WALK, WALK.joints)
    slides_cm = [scores.pop(name) for name in ("heel_slide_cm", "toe_slide_cm")]
    assert all(one is not None and 0.0 <= one < 0.2 for one in slides_cm)
    assert scores == pytest.approx(
        {"heel_mm": 0.0, "toe_mm": 0.0, "foot_pitch_deg": 0.0, "foot_heading_deg": 0.0}, abs=1e-6
    )


def test_lifted_heel_is_error_of_heel_and_of_pitch() -> None:
    move_m = np.zeros((21, 3))
    move_m[WALK.joints.indices(("left_heel", "right_heel"))] = [0.0, 0.0, 0.02]
    scores = score_heels_and_toes(tracks_of(WALK, move_m), WALK, WALK.joints)
    assert scores["heel_mm"] == pytest.approx(20.0)
    assert scores["toe_mm"] == pytest.approx(0.0, abs=1e-6)
    # 2 cm over a foot of some 23 cm.
    assert scores["foot_pitch_deg"] == pytest.approx(np.degrees(0.02 / 0.23), abs=1.0)
    assert scores["foot_heading_deg"] == pytest.approx(0.0, abs=1e-6)


def test_heel_that_trembles_slides() -> None:
    move_m = np.zeros((WALK.truth_m.shape[1], 21, 3))
    # To and fro, so that the median position is the true one.
    move_m[:, WALK.joints.indices(("left_heel", "right_heel")), 0] = np.resize(
        [0.01, 0.0, -0.01, 0.0], (len(move_m), 1)
    )
    scores = score_heels_and_toes(tracks_of(WALK, move_m), WALK, WALK.joints)
    assert scores["heel_slide_cm"] == pytest.approx(0.5, abs=0.15)
    assert scores["toe_slide_cm"] is not None
    assert scores["toe_slide_cm"] < 0.2


def test_tracks_without_feet_have_no_figures() -> None:
    body = record(replace(SCENES["walk"], duration_s=3.0), 1, 2)
    scores = score_heels_and_toes(tracks_of(body, np.zeros((17, 3))), WALK, COCO_17)
    assert set(scores.values()) == {None}
    assert set(score_heels_and_toes([], WALK, WALK.joints).values()) == {None}


def test_angles_have_their_signs() -> None:
    assert pitch_deg(np.array([[1.0, 0.0, -1.0]])) == pytest.approx(45.0)
    ahead, left = np.array([[1.0, 0.0, 0.3]]), np.array([[0.0, 2.0, 0.0]])
    assert heading_error_deg(left, ahead) == pytest.approx(90.0)
    assert heading_error_deg(ahead, left) == pytest.approx(-90.0)


NUM_FRAMES = 40
TIMEBASE = Timebase(0.0, 25.0, NUM_FRAMES)


def standing(outwards_deg: np.ndarray, x_m: float = 0.0, start_frame: int = 0) -> SkeletonMotion:
    """A person in the rest pose whose feet are turned outwards."""
    parent_from_joint = np.tile([0.0, 0.0, 0.0, 1.0], (len(outwards_deg), len(SKELETON), 1))
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        turn = Rotation.from_euler("z", sign * outwards_deg[:, None], degrees=True)
        parent_from_joint[:, INDEX[f"{side}Foot"]] = turn.as_quat()
    length_m = 1.7 * np.array([joint.stature_share for joint in SKELETON])
    root_m = np.tile([x_m, 0.0, 1.0], (len(outwards_deg), 1))
    return SkeletonMotion(1, "person-1", start_frame, 25.0, length_m, root_m, parent_from_joint, ())


def feet_m(motion: SkeletonMotion) -> np.ndarray:
    return np.stack(
        [
            np.stack([joint_pose(motion, f"{side}{end}")[0] for end in ("Foot", "FootEnd")], axis=1)
            for side in ("Left", "Right")
        ],
        axis=1,
    )


TRUTH_M = np.stack([feet_m(standing(np.zeros(NUM_FRAMES), x_m)) for x_m in (5.0, 0.0)])


def test_constant_difference_is_definition() -> None:
    scores = score_foot_directions(
        [standing(np.full(NUM_FRAMES, 8.0))], TIMEBASE, np.arange(NUM_FRAMES) / 25.0, TRUTH_M
    )
    assert scores["foot_heading_spread_deg"] == pytest.approx(0.0, abs=1e-6)
    assert scores["foot_pitch_spread_90_deg"] == pytest.approx(0.0, abs=1e-6)


def test_spread_is_that_around_median() -> None:
    outwards_deg = np.tile([-6.0, -4.0, 0.0, 4.0, 6.0], NUM_FRAMES // 5)
    motions = [standing(outwards_deg[10:], 0.02, 10), standing(outwards_deg, 5.02)]
    scores = score_foot_directions(motions, TIMEBASE, np.arange(NUM_FRAMES) / 25.0, TRUTH_M)
    assert scores["foot_heading_spread_deg"] == pytest.approx(4.0)
    assert scores["foot_heading_spread_90_deg"] == pytest.approx(6.0)


def test_without_motions_there_are_no_figures() -> None:
    scores = score_foot_directions([], TIMEBASE, np.arange(NUM_FRAMES) / 25.0, TRUTH_M)
    assert set(scores.values()) == {None}


HANDS = record(replace(SCENES["hands"], duration_s=5.0), 1, 2, "whole")
LEFT = WHOLE_BODY.indices(finger_joints("left"))


def tracks(move_m: np.ndarray | None = None) -> list[Track3D]:
    shape = HANDS.truth_m.shape[1:3]
    return [
        Track3D(
            number + 1,
            0,
            xyz_m + (0.0 if move_m is None else move_m),
            np.ones(shape),
            np.full(shape, Source.MEASURED),
            np.zeros(shape),
            np.full(shape, 2),
        )
        for number, xyz_m in enumerate(HANDS.truth_m)
    ]


def bent(**angles_deg: float) -> np.ndarray:
    """Wrists and fingers (2, 1, 21, 3) of a left and of a right hand with given angles, in metres."""
    angles = np.zeros((1, 2, len(ANGLES)))
    for name, angle in angles_deg.items():
        angles[..., ANGLES.index(name)] = np.radians(angle)
    wrists_m = np.array([[[0.25, 0.2, 0.0], [0.25, -0.2, 0.0]]])
    elbows_m = wrists_m - np.array([0.25, 0.0, 0.0])
    points_m = fingers(Hands(1.0, angles), elbows_m + np.array([0.0, 0.0, 0.3]), elbows_m, wrists_m)
    return np.concatenate([wrists_m[:, :, None], points_m.reshape(1, 2, 20, 3)], axis=2).swapaxes(0, 1)


def test_truth_has_no_error_and_bends_nowhere_backwards() -> None:
    scores = score_hands(tracks(), HANDS, WHOLE_BODY)
    assert scores["finger_mm"] == pytest.approx(0.0, abs=1e-6)
    assert scores["hands_measured"] == 1.0
    assert scores["backward_bends"] == 0
    assert set(scores["finger_by_joint_mm"]) == {"cmc", "mcp", "ip", "pip", "dip", "tip"}


def test_errors_are_relative_to_wrist() -> None:
    move_m = np.full((61, 3), [0.03, 0.0, 0.0])
    assert score_hands(tracks(move_m), HANDS, WHOLE_BODY)["finger_mm"] == pytest.approx(0.0, abs=1e-6)
    move_m[LEFT] += [0.0, 0.01, 0.0]
    scores = score_hands(tracks(move_m), HANDS, WHOLE_BODY)
    assert scores["finger_mm"] == pytest.approx(5.0)
    assert scores["finger_p95_mm"] == pytest.approx(10.0)


def test_predicted_hands_are_not_measured() -> None:
    source = np.full(HANDS.truth_m.shape[1:3], Source.MEASURED)
    source[:50, LEFT] = Source.PREDICTED
    move_m = np.zeros((61, 3))
    found = [replace(track, source=source) for track in tracks(move_m)]
    far_m = np.where((source == Source.PREDICTED)[..., None], 0.1, 0.0) * np.array([0.0, 1.0, 0.0])
    found = [replace(track, xyz_m=track.xyz_m + far_m) for track in found]
    scores = score_hands(found, HANDS, WHOLE_BODY)
    num_frames = HANDS.timebase.num_frames
    assert scores["hands_measured"] == pytest.approx(1 - 50 / (2 * num_frames))
    assert scores["finger_mm"] == pytest.approx(0.0, abs=1e-6)
    assert scores["finger_all_mm"] == pytest.approx(100.0 * 50 / (2 * num_frames))


def test_tracks_without_hands_have_no_figures() -> None:
    parts = ("xyz_m", "score", "source", "error_px", "views")
    bodies = [replace(track, **{part: getattr(track, part)[:, :17] for part in parts}) for track in tracks()]
    scores = score_hands(bodies, HANDS, COCO_17)
    assert scores["finger_mm"] is None
    assert scores["backward_bends"] is None
    assert scores["hands_measured"] == 0.0


def test_bends_are_angles_of_hinges() -> None:
    both_m = bent(thumb_radial=35.0, thumb_palmar=20.0, thumb_mcp=20.0, thumb_ip=30.0, ring_mcp=25.0, ring_pip=40.0)
    sides: tuple[Side, Side] = ("left", "right")
    for hand_m, side in zip(both_m, sides, strict=True):
        bends = bends_deg(hand_m, side)[0]
        np.testing.assert_allclose(bends[:2], [20.0, 30.0], atol=1e-6)
        # The palm's middle finger lies a little behind the others: the axes of the palm are tilted by two degrees.
        np.testing.assert_allclose(bends[2:6], [0.0, 0.0, 25.0, 0.0], atol=5.0)
        np.testing.assert_allclose(bends[10:12], [40.0, DIP_SHARE * 40.0], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "angle", "expected"),
    [("index_pip", -20.0, 2), ("index_pip", 20.0, 0), ("pinky_mcp", -60.0, 1), ("pinky_mcp", -10.0, 0),
     ("thumb_ip", -30.0, 1)],
)  # fmt: skip
@pytest.mark.parametrize("side", ["left", "right"])
def test_backward_bends_are_counted(name: str, angle: float, expected: int, side: str) -> None:
    natural = {"thumb_radial": 35.0, "thumb_palmar": 20.0, "index_pip": 8.0, "middle_pip": 8.0, "ring_pip": 8.0}
    wanted = natural | {"pinky_pip": 8.0, name: angle}
    hand_m = bent(**wanted)[("left", "right").index(side)]
    xyz_m = np.full((1, 61, 3), np.nan)
    xyz_m[:, WHOLE_BODY.indices((f"{side}_wrist", *finger_joints(side)))] = hand_m
    shape = xyz_m.shape[:2]
    track = Track3D(1, 0, xyz_m, np.ones(shape), np.full(shape, Source.MEASURED), np.zeros(shape), np.full(shape, 2))
    assert count_backward_bends([track], WHOLE_BODY) == expected
