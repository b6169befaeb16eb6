"""Lengths of finger bones: noise does not lengthen them, both hands share them, and proportions fill in."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.people import Source
from pipeline.core.joints import WHOLE_BODY, finger_joints
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.hands.proportions import whole_lengths_m
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON
from tests.pipeline.motion.skeleton.hands.people import gesturing, landmarks_of
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of

NUM_FRAMES = 200
BODY = slice(0, len(SKELETON))
FINGERS = slice(len(SKELETON), None)


def lengths_m(xyz_m: np.ndarray, *, left: bool = True, right: bool = True) -> np.ndarray:
    seen = {side: np.full(len(xyz_m), is_seen) for side, is_seen in zip(SIDES, (left, right), strict=True)}
    return whole_lengths_m(gesturing(NUM_FRAMES).bone_length_m[BODY], track_of(xyz_m), WHOLE_BODY, seen)


def test_noise_does_not_lengthen_bones() -> None:
    true_m = landmarks_of(gesturing(NUM_FRAMES))
    noisy_m = true_m + np.random.default_rng(0).normal(0.0, 0.006, true_m.shape)
    found_m, bones_m = lengths_m(noisy_m)[FINGERS], gesturing(NUM_FRAMES).bone_length_m[FINGERS]
    np.testing.assert_allclose(found_m, bones_m, atol=0.002)
    # Lengths of noisy vectors are longer by the noise across them: by 3 mm for the ends of fingers.
    ends = WHOLE_BODY.indices(("left_index_dip", "left_index_tip"))
    naive_m = np.median(np.linalg.norm(noisy_m[:, ends[1]] - noisy_m[:, ends[0]], axis=-1))
    assert naive_m > bones_m[INDEX["LeftHandIndex3End"] - len(SKELETON)] + 0.002


@pytest.mark.parametrize("scale", [0.85, 1.2])
def test_a_hand_that_is_seen_gives_the_lengths_of_both(scale: float) -> None:
    found_m = lengths_m(landmarks_of(gesturing(NUM_FRAMES, scale)), right=False)[FINGERS]
    np.testing.assert_allclose(found_m, gesturing(NUM_FRAMES, scale).bone_length_m[FINGERS], rtol=0.03)
    np.testing.assert_array_equal(found_m[:20], found_m[20:])


def test_unseen_hands_have_adult_proportions_at_the_size_of_the_forearm() -> None:
    found_m = lengths_m(landmarks_of(gesturing(NUM_FRAMES, 1.2)), left=False, right=False)
    shares = np.array([joint.stature_share for joint in WHOLE_SKELETON])
    forearm = INDEX["LeftHand"]
    np.testing.assert_allclose(found_m[FINGERS], shares[FINGERS] * found_m[forearm] / shares[forearm])
    np.testing.assert_array_equal(found_m[BODY], gesturing(NUM_FRAMES).bone_length_m[BODY])


def test_a_finger_that_was_never_seen_has_the_size_of_the_hand() -> None:
    true_m = landmarks_of(gesturing(NUM_FRAMES, 1.2))
    pinkies = [WHOLE_BODY.index(name) for side in SIDES for name in finger_joints(side) if "pinky" in name]
    true_m[:, pinkies] = np.nan
    np.testing.assert_allclose(lengths_m(true_m)[FINGERS], gesturing(NUM_FRAMES, 1.2).bone_length_m[FINGERS], rtol=0.03)


def test_an_implausible_bone_stays_near_proportions() -> None:
    true_m = landmarks_of(gesturing(NUM_FRAMES))
    tips = WHOLE_BODY.indices(("left_index_tip", "right_index_tip"))
    true_m[:, tips] += [0.0, 0.0, 0.3]
    end = INDEX["LeftHandIndex3End"]
    usual_m = gesturing(NUM_FRAMES).bone_length_m[end]
    assert lengths_m(true_m)[end] < 1.7 * usual_m


def test_unmeasured_joints_are_no_evidence() -> None:
    track = track_of(landmarks_of(gesturing(NUM_FRAMES, 1.2)))
    predicted = replace(track, source=np.full_like(track.source, Source.PREDICTED))
    seen = {side: np.zeros(NUM_FRAMES, bool) for side in SIDES}
    body_m = gesturing(NUM_FRAMES).bone_length_m[BODY]
    found_m = whole_lengths_m(body_m, predicted, WHOLE_BODY, seen)
    np.testing.assert_allclose(found_m[FINGERS], gesturing(NUM_FRAMES).bone_length_m[FINGERS])
