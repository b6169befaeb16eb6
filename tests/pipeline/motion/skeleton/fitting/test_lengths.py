"""Lengths of bones that are solved for together with the motion."""

import numpy as np
import pytest
from jaxtyping import Float

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.motion.skeleton.fitting.fit import SkeletonFit, fit_to_rays, follow
from pipeline.motion.skeleton.landmarks import Landmarks, bone_lengths_m
from pipeline.motion.skeleton.model import INDEX, TRUNK
from tests.acrobatics.acrobat import acrobat_joints_at, perform_acrobatics
from tests.acrobatics.key_poses import KeyPose
from tests.pipeline.motion.skeleton.observed import observe, ring_of

RATE_HZ = 30.0
CAMERAS = ring_of(5)
TRUNK_INDICES = [INDEX[name] for name in TRUNK]


def fit_of(truth_m: Float[np.ndarray, "frames joints 3"]) -> tuple[Track3D, SkeletonFit, Float[np.ndarray, " joints"]]:
    """Track, fit and lengths of a person who is seen with noise."""
    track, seen = observe(CAMERAS, truth_m, noise_px=1.5, seed=3)
    fitted = fit_to_rays(track, seen, CAMERAS, Timebase(0.0, RATE_HZ, len(truth_m)), COCO_17, "anna")
    return track, fitted, fitted.motion().bone_length_m


def curling(most_deg: float) -> tuple[Float[np.ndarray, "frames 17 3"], float]:
    """A person who is curled up most of the time, and the length of the trunk."""
    bent = {"spine_bend": most_deg, "leg_raise": 70.0, "knee": 80.0, "arm_raise": 40.0, "elbow": 60.0}
    keys = (
        KeyPose(0.0, {**bent, "spine_bend": 0.0}),
        KeyPose(0.6, bent),
        KeyPose(2.4, {**bent, "spine_side": 15.0}),
        KeyPose(3.0, {**bent, "spine_bend": 0.0}),
    )
    acrobat = perform_acrobatics(keys, (0.0, 0.0), 0.3, 3.5, np.random.default_rng(8))
    time_s = np.arange(0.0, 3.4, 1 / RATE_HZ)
    return acrobat_joints_at(acrobat, time_s, BODY_FEET)[:, :17], acrobat.body.proportions.trunk_m


def test_trunk_curled_most_of_time_is_not_too_short() -> None:
    truth_m, trunk_m = curling(85.0)
    track, _, lengths_m = fit_of(truth_m)
    medians_m = bone_lengths_m(Landmarks(track.xyz_m, track.source, COCO_17))
    too_short_m = trunk_m - medians_m[TRUNK_INDICES].sum()
    assert too_short_m > 0.02
    assert abs(trunk_m - lengths_m[TRUNK_INDICES].sum()) < 0.6 * too_short_m


def test_limbs_of_different_lengths_keep_them() -> None:
    """A figure whose left thigh is a sixth shorter, such as of a poster that is seen askew."""
    truth_m, _ = curling(10.0)
    hip, knee, ankle = COCO_17.indices(("left_hip", "left_knee", "left_ankle"))
    shift_m = 0.17 * (truth_m[:, hip] - truth_m[:, knee])
    truth_m[:, [knee, ankle]] += shift_m[:, None]
    track, _, lengths_m = fit_of(truth_m)
    medians_m = bone_lengths_m(Landmarks(track.xyz_m, track.source, COCO_17))
    right_m = np.linalg.norm(truth_m[0, COCO_17.index("right_hip")] - truth_m[0, COCO_17.index("right_knee")])
    # Three seconds are no more evidence against the symmetry of bodies than that.
    assert lengths_m[INDEX["RightLeg"]] / lengths_m[INDEX["LeftLeg"]] > 1.08
    assert abs(lengths_m[INDEX["RightLeg"]] - right_m) < 0.7 * abs(medians_m[INDEX["RightLeg"]] - right_m)
    assert np.isclose(medians_m[INDEX["RightLeg"]], medians_m[INDEX["LeftLeg"]])


@pytest.mark.parametrize(("side", "nearer"), [("left", 0.5), ("right", 0.65)])
def test_forearm_hidden_most_of_time_is_whole_where_seen(side: str, nearer: float) -> None:
    """In four of five frames two cameras alone mark a wrist, at the edge of the thing that hides the hand."""
    truth_m, _ = curling(10.0)
    elbow, wrist = COCO_17.indices((f"{side}_elbow", f"{side}_wrist"))
    hidden = slice(0, int(0.8 * len(truth_m)))
    marked_m = truth_m.copy()
    marked_m[hidden, wrist] += (1.0 - nearer) * (truth_m[hidden, elbow] - truth_m[hidden, wrist])
    unseen = np.zeros((len(truth_m), len(CAMERAS), 17), bool)
    unseen[hidden, 2:, wrist] = True
    track, seen = observe(CAMERAS, marked_m, noise_px=1.5, unseen=unseen, seed=5)
    fitted = fit_to_rays(track, seen, CAMERAS, Timebase(0.0, RATE_HZ, len(truth_m)), COCO_17, "anna")
    motion = fitted.motion()
    forearm_m = float(np.median(np.linalg.norm(truth_m[:, wrist] - truth_m[:, elbow], axis=-1)))
    for name in ("LeftHand", "RightHand"):
        assert motion.bone_length_m[INDEX[name]] == pytest.approx(forearm_m, rel=0.10)
    found_m = follow(fitted, motion, seen, CAMERAS).xyz_m[hidden.stop + 5 :, wrist]
    off_m = np.linalg.norm(found_m - truth_m[hidden.stop + 5 :, wrist], axis=-1)
    assert off_m.max() < 0.025


def test_lengths_that_differ_by_chance_stay_as_they_are() -> None:
    truth_m, _ = curling(0.0)
    track, fitted, lengths_m = fit_of(truth_m)
    assert np.linalg.norm(np.ptp(truth_m[:, COCO_17.index("left_wrist")], axis=0)) > 0.05
    np.testing.assert_array_equal(lengths_m, bone_lengths_m(Landmarks(fitted.track.xyz_m, track.source, COCO_17)))


def test_lengths_that_nobody_saw_keep_their_start() -> None:
    truth_m, _ = curling(10.0)
    ankles = COCO_17.indices(("left_ankle", "right_ankle"))
    truth_m[:, ankles] = np.nan
    track, _, lengths_m = fit_of(truth_m)
    medians_m = bone_lengths_m(Landmarks(track.xyz_m, track.source, COCO_17))
    assert (track.source[:, ankles] == Source.ABSENT).all()
    assert lengths_m[INDEX["LeftFoot"]] == pytest.approx(medians_m[INDEX["LeftFoot"]], rel=0.02)
    assert np.isfinite(lengths_m).all()
