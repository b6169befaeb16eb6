"""Lengths of bones from landmarks: one length for both sides, the one that views, frames and proportions support."""

import numpy as np
import pytest

from pipeline.core.data.people import Source
from pipeline.core.joints import COCO_17
from pipeline.motion.skeleton.fitting.positions import hanging_limbs
from pipeline.motion.skeleton.landmarks import Landmarks, bone_lengths_m, limb_lengths_m
from pipeline.motion.skeleton.model import INDEX
from tests.pipeline.motion.skeleton.synthetic_tracks import FOREARM_M, SHIN_M, THIGH_M, UPPER_ARM_M, track_of, walker

TRUE_M = {"elbow": UPPER_ARM_M, "wrist": FOREARM_M, "knee": THIGH_M, "ankle": SHIN_M}
UPPER_END = {"elbow": "shoulder", "wrist": "elbow", "knee": "hip", "ankle": "knee"}
BONE = {"elbow": "ForeArm", "wrist": "Hand", "knee": "Leg", "ankle": "Foot"}


def stretched(xyz_m: np.ndarray, joint: str, factor: float, frames: slice = slice(None)) -> np.ndarray:
    """Positions with a joint, and the joint below it, at another distance from the upper end of its limb."""
    side, _, kind = joint.partition("_")
    lower, upper = COCO_17.index(joint), COCO_17.index(f"{side}_{UPPER_END[kind]}")
    shift_m = (factor - 1.0) * (xyz_m[frames, lower] - xyz_m[frames, upper])
    below = [COCO_17.index(f"{side}_{end}") for end, start in UPPER_END.items() if start == kind]
    moved_m = xyz_m.copy()
    for moved in (lower, *below):
        moved_m[frames, moved] += shift_m
    return moved_m


def landmarks_of(xyz_m: np.ndarray, views: np.ndarray | int = 4) -> Landmarks:
    track = track_of(xyz_m)
    return Landmarks(track.xyz_m, track.source, COCO_17, np.broadcast_to(views, track.source.shape))


@pytest.mark.parametrize("kind", list(TRUE_M))
@pytest.mark.parametrize("factor", [0.48, 0.7, 1.4, 1.9])
def test_side_measured_wrong_gets_length_of_other_side(kind: str, factor: float) -> None:
    """The wrong side is measured in more frames, and as exactly as the right one."""
    xyz_m = stretched(walker(60), f"left_{kind}", factor)
    xyz_m[::3, COCO_17.index(f"right_{kind}")] = np.nan
    landmarks = landmarks_of(xyz_m)
    assert limb_lengths_m(landmarks)[kind] == pytest.approx(TRUE_M[kind], rel=0.01)
    lengths_m = bone_lengths_m(landmarks)
    assert lengths_m[INDEX[f"Left{BONE[kind]}"]] == lengths_m[INDEX[f"Right{BONE[kind]}"]]
    assert lengths_m[INDEX[f"Left{BONE[kind]}"]] == pytest.approx(TRUE_M[kind], rel=0.01)
    hanging = dict(hanging_limbs(landmarks)[COCO_17.index(f"left_{kind}")])
    assert hanging[COCO_17.index(f"left_{UPPER_END[kind]}")] == pytest.approx(TRUE_M[kind], rel=0.01)


def test_two_limbs_with_wrong_side_each_are_both_right() -> None:
    xyz_m = stretched(stretched(walker(60), "left_wrist", 0.5), "right_knee", 0.72)
    lengths_m = limb_lengths_m(landmarks_of(xyz_m))
    assert lengths_m["wrist"] == pytest.approx(FOREARM_M, rel=0.01)
    assert lengths_m["knee"] == pytest.approx(THIGH_M, rel=0.01)


def test_length_by_many_cameras_beats_few_wrong_ones() -> None:
    """Both wrists are hidden from all but two cameras in most frames, which place them too near to the elbows."""
    hidden = slice(0, 40)
    xyz_m = stretched(stretched(walker(60), "left_wrist", 0.8, hidden), "right_wrist", 0.8, hidden)
    views = np.full(xyz_m.shape[:2], 5)
    views[hidden] = 2
    assert limb_lengths_m(landmarks_of(xyz_m, views))["wrist"] == pytest.approx(FOREARM_M, rel=0.01)
    assert limb_lengths_m(landmarks_of(xyz_m))["wrist"] == pytest.approx(0.8 * FOREARM_M, rel=0.01)


@pytest.mark.parametrize("views_of_right", [2, 5])
def test_sides_that_are_both_plausible_go_by_their_views(views_of_right: int) -> None:
    """Neither thigh is out of proportion: one is a seventh too short, the other one as much too long."""
    xyz_m = stretched(stretched(walker(60), "left_knee", 1.0 / 1.15), "right_knee", 1.15)
    views = np.full(xyz_m.shape[:2], 7 - views_of_right)
    views[:, COCO_17.indices(("right_hip", "right_knee"))] = views_of_right
    is_longer = limb_lengths_m(landmarks_of(xyz_m, views))["knee"] > THIGH_M
    assert is_longer == (views_of_right == 5)


def test_shins_cut_by_table_get_length_by_proportions() -> None:
    xyz_m = stretched(stretched(walker(60), "left_ankle", 0.45), "right_ankle", 0.5)
    # The walker's own proportions differ from usual ones.
    assert limb_lengths_m(landmarks_of(xyz_m))["ankle"] == pytest.approx(SHIN_M, rel=0.15)


def test_small_body_keeps_its_own_proportions() -> None:
    """Legs that are a quarter shorter than usual beside the trunk and the arms."""
    xyz_m = walker(60)
    for kind in ("knee", "ankle"):
        for side in ("left", "right"):
            xyz_m = stretched(xyz_m, f"{side}_{kind}", 0.75)
    knees, hips = (xyz_m[:, COCO_17.index(f"left_{kind}")] for kind in ("knee", "hip"))
    thigh_m = float(np.median(np.linalg.norm(knees - hips, axis=-1)))
    assert thigh_m == pytest.approx(0.75 * THIGH_M)
    assert limb_lengths_m(landmarks_of(xyz_m))["knee"] == pytest.approx(thigh_m)


def test_sides_that_agree_have_median_of_all_frames() -> None:
    rng = np.random.default_rng(0)
    xyz_m = walker(99)
    for frame in range(99):
        for side, mean in (("left", 0.97), ("right", 1.03)):
            xyz_m = stretched(xyz_m, f"{side}_knee", mean + 0.02 * rng.normal(), slice(frame, frame + 1))
    ends_m = {name: xyz_m[:, COCO_17.index(name)] for name in ("left_hip", "left_knee", "right_hip", "right_knee")}
    both_m = [np.linalg.norm(ends_m[f"{side}_hip"] - ends_m[f"{side}_knee"], axis=-1) for side in ("left", "right")]
    assert limb_lengths_m(landmarks_of(xyz_m))["knee"] == pytest.approx(float(np.median(both_m)))


def test_few_lengths_that_scatter_decide_nothing() -> None:
    """Three frames of each side, which differ as much among each other as the sides do."""
    xyz_m = walker(6)
    xyz_m[:3, COCO_17.index("right_ankle")] = xyz_m[3:, COCO_17.index("left_ankle")] = np.nan
    for frame, factor in enumerate((0.75, 1.05, 1.38, 0.95, 1.25, 1.52)):
        side = "left" if frame < 3 else "right"
        xyz_m = stretched(xyz_m, f"{side}_ankle", factor, slice(frame, frame + 1))
    assert limb_lengths_m(landmarks_of(xyz_m))["ankle"] == pytest.approx(SHIN_M * (1.05 + 1.25) / 2)


def test_side_never_measured_gets_length_of_other_side() -> None:
    xyz_m = walker(20)
    xyz_m[:, COCO_17.index("left_wrist")] = np.nan
    assert limb_lengths_m(landmarks_of(xyz_m))["wrist"] == pytest.approx(FOREARM_M)
    xyz_m[:, COCO_17.index("right_wrist")] = np.nan
    landmarks = landmarks_of(xyz_m)
    assert np.isnan(limb_lengths_m(landmarks)["wrist"])
    assert 0.8 * FOREARM_M < bone_lengths_m(landmarks)[INDEX["LeftHand"]] < 1.2 * FOREARM_M
    assert (landmarks.source[:, COCO_17.index("left_wrist")] == Source.ABSENT).all()


def test_positions_without_numbers_of_views_count_alike() -> None:
    track = track_of(stretched(walker(60), "left_knee", 0.5))
    assert limb_lengths_m(Landmarks(track.xyz_m, track.source, COCO_17))["knee"] == pytest.approx(THIGH_M, rel=0.01)


def test_nobody_measured_has_bones_of_adult() -> None:
    landmarks = landmarks_of(np.full((3, 17, 3), np.nan))
    assert all(np.isnan(length_m) for length_m in limb_lengths_m(landmarks).values())
    assert bone_lengths_m(landmarks)[INDEX["LeftFoot"]] == pytest.approx(0.246 * 1.70)
