"""Hands of whole people through the animation: accuracy, limits, hands that nobody saw."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Animation, Side, SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source
from pipeline.core.joints import BODY_FEET, FINGER_JOINTS, WHOLE_BODY, JointSet, finger_joints
from pipeline.core.options.config import ReconstructionConfig, Smoothing
from pipeline.motion.skeleton import time_series
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.hands.anatomy import HINGES, articulate_hand, hand_fingers, joint_rotations, natural_rad
from pipeline.motion.skeleton.hands.whole import whole_lengths_m
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, forward_kinematics
from tests.pipeline.motion.skeleton.hands.people import RATE_HZ, gesturing, landmarks_of
from tests.pipeline.motion.skeleton.observed import observe, ring_of
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of

NUM_FRAMES = 120
FINGERS_OF = {side: np.array(WHOLE_BODY.indices(finger_joints(side))) for side in SIDES}
WRIST_OF = {side: WHOLE_BODY.index(f"{side}_wrist") for side in SIDES}
_TOLERANCE_RAD = 1e-6


def hidden(*, left: slice = slice(0, 0), right: slice = slice(0, 0), num_cameras: int = 6) -> np.ndarray:
    """Views without the fingers of a side in some frames."""
    unseen = np.zeros((NUM_FRAMES, num_cameras, len(WHOLE_BODY.names)), bool)
    unseen[left, :, FINGERS_OF["left"][0] : FINGERS_OF["left"][-1] + 1] = True
    unseen[right, :, FINGERS_OF["right"][0] : FINGERS_OF["right"][-1] + 1] = True
    return unseen


def animate_whole(
    unseen: np.ndarray | None = None,
    noise_px: float = 2.0,
    smoothing: Smoothing = "fit",
    num_frames: int = NUM_FRAMES,
    hand_scale: float = 1.0,
) -> Animation:
    cameras = ring_of(6)
    track, seen = observe(cameras, landmarks_of(gesturing(num_frames, hand_scale)), noise_px, unseen)
    timebase = Timebase(0.0, RATE_HZ, num_frames)
    return animate([track], [seen], cameras, timebase, WHOLE_BODY, ReconstructionConfig(smoothing=smoothing))


@cache
def noisy() -> Animation:
    return animate_whole()


def error_m(animation: Animation, side: Side, num_frames: int = NUM_FRAMES, hand_scale: float = 1.0) -> np.ndarray:
    """Errors of the joints of fingers relative to the wrist."""
    true_m = landmarks_of(gesturing(num_frames, hand_scale))
    found_m = animation.tracks[0].xyz_m
    relative = [one[:, FINGERS_OF[side]] - one[:, [WRIST_OF[side]]] for one in (found_m, true_m)]
    return np.asarray(np.linalg.norm(relative[0] - relative[1], axis=-1))


def hinge_angles_rad(motion: SkeletonMotion, side: Side) -> np.ndarray:
    """Angles of the hinges of fingers beyond their bases, and the rest of their rotations, (frames, 10, 2)."""
    found = []
    for finger in hand_fingers(side).values():
        for joint, axis in zip(finger.joints[1:3], finger.bend_axes[1:], strict=True):
            turned = Rotation.from_quat(motion.parent_from_joint[:, joint]).as_rotvec()
            along = turned @ axis
            found.append(np.stack([along, np.linalg.norm(turned - along[:, None] * axis, axis=-1)], axis=-1))
    return np.stack(found, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_fingers_are_accurate_in_noise(side: Side) -> None:
    error = error_m(noisy(), side)
    assert error.mean() < 0.006
    assert np.quantile(error, 0.95) < 0.012
    assert (noisy().tracks[0].source[:, FINGERS_OF[side]] == Source.MEASURED).mean() > 0.99


def test_fingers_seen_exactly_stay_where_they_are() -> None:
    animation = animate_whole(noise_px=0.0)
    for side in SIDES:
        assert error_m(animation, side).mean() < 0.003


def test_large_hands_are_large() -> None:
    animation = animate_whole(hand_scale=1.15)
    found_m = animation.motions[0].bone_length_m[len(SKELETON) :]
    true_m = gesturing(NUM_FRAMES, 1.15).bone_length_m[len(SKELETON) :]
    np.testing.assert_allclose(found_m, true_m, atol=0.003)
    np.testing.assert_array_equal(found_m[:20], found_m[20:])  # both hands are equal


@pytest.mark.parametrize("side", SIDES)
def test_no_finger_bends_backwards(side: Side) -> None:
    rough = animate_whole(noise_px=6.0)
    angle_rad, aside_rad = np.moveaxis(hinge_angles_rad(rough.motions[0], side), -1, 0)
    assert angle_rad.min() >= -_TOLERANCE_RAD
    assert angle_rad.max() <= np.radians(115.0) + _TOLERANCE_RAD
    assert aside_rad.max() < _TOLERANCE_RAD


def test_fingers_are_where_skeleton_has_them() -> None:
    (track,), (motion,) = noisy().tracks, noisy().motions
    assert motion.parent_from_joint.shape[1] == len(WHOLE_SKELETON)
    posed_m = forward_kinematics(motion)
    for number, joint in enumerate(WHOLE_SKELETON):
        if len(joint.landmarks) == 1:
            np.testing.assert_allclose(
                track.xyz_m[:, WHOLE_BODY.index(joint.landmarks[0])], posed_m[:, number], atol=1e-6
            )


def test_hand_that_nobody_saw_rests_in_natural_pose() -> None:
    animation = animate_whole(hidden(left=slice(None)))
    (track,), (motion,) = animation.tracks, animation.motions
    assert (track.source[:, FINGERS_OF["left"]] == Source.PREDICTED).all()
    assert (track.source[:, FINGERS_OF["right"]] == Source.MEASURED).mean() > 0.99
    assert np.isfinite(track.xyz_m[:, FINGERS_OF["left"]]).all()
    numbers, rotations = joint_rotations("left", np.tile(natural_rad(), (NUM_FRAMES, 1)))
    for number, rotation in zip(numbers, rotations, strict=True):
        turned = Rotation.from_quat(motion.parent_from_joint[:, number])
        assert (turned.inv() * rotation).magnitude().max() < 1e-9
    np.testing.assert_array_equal(motion.parent_from_joint[:, INDEX["LeftHand"]], [[0.0, 0.0, 0.0, 1.0]] * NUM_FRAMES)


def test_hand_seen_by_one_camera_only_is_predicted() -> None:
    unseen = hidden(left=slice(None))
    unseen[:, 0] = False
    assert (animate_whole(unseen).tracks[0].source[:, FINGERS_OF["left"]] == Source.PREDICTED).all()


def test_long_gap_passes_to_natural_pose_and_back_smoothly() -> None:
    gap = slice(40, 90)
    animation = animate_whole(hidden(left=gap), noise_px=0.5)
    (track,), (motion,) = animation.tracks, animation.motions
    source = track.source[:, FINGERS_OF["left"]]
    assert (source[gap] == Source.PREDICTED).all()
    assert (source[:40] == Source.MEASURED).all()
    in_middle = slice(60, 70)
    for hinge, number in zip((6, 10, 14, 18), ("Index", "Middle", "Ring", "Pinky"), strict=True):
        quat = motion.parent_from_joint[in_middle, INDEX[f"LeftHand{number}2"]]
        bend_rad = Rotation.from_quat(quat).magnitude()
        np.testing.assert_allclose(bend_rad, natural_rad()[hinge], atol=np.radians(4.0))
    quat = motion.parent_from_joint[:, INDEX["LeftHand"] :]
    step_rad = 2 * np.arccos(np.clip(np.abs((quat[1:] * quat[:-1]).sum(-1)), 0.0, 1.0))
    assert np.degrees(step_rad.max()) < 25.0
    assert np.isnan(np.asarray(track.uncertainty_m)[gap][:, FINGERS_OF["left"]]).all()


def test_hands_that_no_camera_saw_are_same_for_everybody() -> None:
    """The joint set has fingers, but no observation of them exists."""
    animation = animate_whole(hidden(left=slice(None), right=slice(None)))
    (motion,) = animation.motions
    assert motion.parent_from_joint.shape[1] == len(WHOLE_SKELETON)
    shares = motion.bone_length_m / motion.bone_length_m[INDEX["LeftHand"]]
    usual = np.array([joint.stature_share for joint in WHOLE_SKELETON]) / SKELETON[INDEX["LeftHand"]].stature_share
    np.testing.assert_allclose(shares[len(SKELETON) :], usual[len(SKELETON) :])


def test_body_is_same_with_and_without_fingers() -> None:
    cameras = ring_of(6)
    track, seen = observe(cameras, landmarks_of(gesturing(60)), 2.0)
    body = [WHOLE_BODY.index(name) for name in BODY_FEET.names]
    alone = replace(
        track,
        **{name: getattr(track, name)[:, body] for name in ("xyz_m", "score", "source", "error_px", "views")},
    )
    alone_seen = replace(seen, points_px=seen.points_px[:, :, body], score=seen.score[:, :, body])
    timebase, config = Timebase(0.0, RATE_HZ, 60), ReconstructionConfig()
    whole = animate([track], [seen], cameras, timebase, WHOLE_BODY, config)
    without = animate([alone], [alone_seen], cameras, timebase, BODY_FEET, config)
    np.testing.assert_array_equal(whole.tracks[0].xyz_m[:, body], without.tracks[0].xyz_m)
    np.testing.assert_array_equal(np.asarray(whole.tracks[0].uncertainty_m)[:, body], without.tracks[0].uncertainty_m)
    assert without.motions[0].parent_from_joint.shape[1] == len(SKELETON)


def test_order_of_joints_is_that_of_set() -> None:
    cameras = ring_of(6)
    names = tuple(sorted(WHOLE_BODY.names))
    joints = JointSet(names, ())
    order = [WHOLE_BODY.index(name) for name in names]
    true_m = landmarks_of(gesturing(40))
    track, seen = observe(cameras, true_m[:, order], 0.5)
    animation = animate([track], [seen], cameras, Timebase(0.0, RATE_HZ, 40), joints, ReconstructionConfig())
    found_m = animation.tracks[0].xyz_m
    assert np.linalg.norm(found_m - true_m[:, order], axis=-1).mean() < 0.01
    assert set(names) > FINGER_JOINTS


@pytest.mark.parametrize("smoothing", ["none", "butterworth"])
def test_hands_follow_smoothed_positions(smoothing: Smoothing) -> None:
    animation = animate_whole(noise_px=0.5, smoothing=smoothing)
    posed_m = forward_kinematics(animation.motions[0])
    for side in SIDES:
        tips = [finger.joints[3] for finger in hand_fingers(side).values()]
        seen_m = animation.tracks[0].xyz_m[:, FINGERS_OF[side][3::HINGES]]
        assert np.linalg.norm(posed_m[:, tips] - seen_m, axis=-1).mean() < 0.015


def test_windows_leave_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_series, "_WINDOW_FRAMES", 100)
    cut = animate_whole()
    whole_m, cut_m = (forward_kinematics(one.motions[0]) for one in (noisy(), cut))
    assert np.linalg.norm(whole_m - cut_m, axis=-1).max() < 0.01


@pytest.mark.parametrize("num_frames", [1, 2, 3])
def test_short_tracks(num_frames: int) -> None:
    animation = animate_whole(num_frames=num_frames, noise_px=0.0)
    for side in SIDES:
        assert error_m(animation, side, num_frames).mean() < 0.01


def test_body_without_torso_has_natural_hands_and_fingers() -> None:
    cameras = ring_of(6)
    true_m = landmarks_of(gesturing(20))
    kept = [WHOLE_BODY.index("left_wrist"), *FINGERS_OF["left"]]
    lost = np.setdiff1d(np.arange(len(WHOLE_BODY.names)), kept)
    true_m[:, lost] = np.nan
    track, seen = observe(cameras, true_m)
    animation = animate([track], [seen], cameras, Timebase(0.0, RATE_HZ, 20), WHOLE_BODY, ReconstructionConfig())
    np.testing.assert_array_equal(animation.tracks[0].xyz_m[:, FINGERS_OF["left"]], track.xyz_m[:, FINGERS_OF["left"]])
    assert animation.motions[0].parent_from_joint.shape[1] == len(WHOLE_SKELETON)


def test_hinges_of_both_hands_are_mirrored() -> None:
    lengths_m = gesturing(1).bone_length_m
    left, right = (articulate_hand(side, lengths_m) for side in SIDES)
    np.testing.assert_allclose(left.landmark_offset_m, right.landmark_offset_m * [-1.0, 1.0, 1.0])
    np.testing.assert_allclose(left.offset_m, right.offset_m * [-1.0, 1.0, 1.0])
    np.testing.assert_array_equal(left.lowest_rad, right.lowest_rad)


PROPORTIONS_FRAMES = 200
BODY = slice(0, len(SKELETON))
FINGERS = slice(len(SKELETON), None)


def lengths_m(xyz_m: np.ndarray, *, left: bool = True, right: bool = True) -> np.ndarray:
    seen = {side: np.full(len(xyz_m), is_seen) for side, is_seen in zip(SIDES, (left, right), strict=True)}
    return whole_lengths_m(gesturing(PROPORTIONS_FRAMES).bone_length_m[BODY], track_of(xyz_m), WHOLE_BODY, seen)


def test_noise_does_not_lengthen_bones() -> None:
    true_m = landmarks_of(gesturing(PROPORTIONS_FRAMES))
    noisy_m = true_m + np.random.default_rng(0).normal(0.0, 0.006, true_m.shape)
    found_m, bones_m = lengths_m(noisy_m)[FINGERS], gesturing(PROPORTIONS_FRAMES).bone_length_m[FINGERS]
    np.testing.assert_allclose(found_m, bones_m, atol=0.002)
    # Lengths of noisy vectors are longer by the noise across them: by 3 mm for the ends of fingers.
    ends = WHOLE_BODY.indices(("left_index_dip", "left_index_tip"))
    naive_m = np.median(np.linalg.norm(noisy_m[:, ends[1]] - noisy_m[:, ends[0]], axis=-1))
    assert naive_m > bones_m[INDEX["LeftHandIndex3End"] - len(SKELETON)] + 0.002


@pytest.mark.parametrize("scale", [0.85, 1.2])
def test_hand_that_is_seen_gives_lengths_of_both(scale: float) -> None:
    found_m = lengths_m(landmarks_of(gesturing(PROPORTIONS_FRAMES, scale)), right=False)[FINGERS]
    np.testing.assert_allclose(found_m, gesturing(PROPORTIONS_FRAMES, scale).bone_length_m[FINGERS], rtol=0.03)
    np.testing.assert_array_equal(found_m[:20], found_m[20:])


def test_unseen_hands_have_adult_proportions_of_forearm() -> None:
    found_m = lengths_m(landmarks_of(gesturing(PROPORTIONS_FRAMES, 1.2)), left=False, right=False)
    shares = np.array([joint.stature_share for joint in WHOLE_SKELETON])
    forearm = INDEX["LeftHand"]
    np.testing.assert_allclose(found_m[FINGERS], shares[FINGERS] * found_m[forearm] / shares[forearm])
    np.testing.assert_array_equal(found_m[BODY], gesturing(PROPORTIONS_FRAMES).bone_length_m[BODY])


def test_finger_that_was_never_seen_has_size_of_hand() -> None:
    true_m = landmarks_of(gesturing(PROPORTIONS_FRAMES, 1.2))
    pinkies = [WHOLE_BODY.index(name) for side in SIDES for name in finger_joints(side) if "pinky" in name]
    true_m[:, pinkies] = np.nan
    np.testing.assert_allclose(
        lengths_m(true_m)[FINGERS], gesturing(PROPORTIONS_FRAMES, 1.2).bone_length_m[FINGERS], rtol=0.03
    )


def test_implausible_bone_stays_near_proportions() -> None:
    true_m = landmarks_of(gesturing(PROPORTIONS_FRAMES))
    tips = WHOLE_BODY.indices(("left_index_tip", "right_index_tip"))
    true_m[:, tips] += [0.0, 0.0, 0.3]
    end = INDEX["LeftHandIndex3End"]
    usual_m = gesturing(PROPORTIONS_FRAMES).bone_length_m[end]
    assert lengths_m(true_m)[end] < 1.7 * usual_m


def test_unmeasured_joints_are_no_evidence() -> None:
    track = track_of(landmarks_of(gesturing(PROPORTIONS_FRAMES, 1.2)))
    predicted = replace(track, source=np.full_like(track.source, Source.PREDICTED))
    seen = {side: np.zeros(PROPORTIONS_FRAMES, bool) for side in SIDES}
    body_m = gesturing(PROPORTIONS_FRAMES).bone_length_m[BODY]
    found_m = whole_lengths_m(body_m, predicted, WHOLE_BODY, seen)
    np.testing.assert_allclose(found_m[FINGERS], gesturing(PROPORTIONS_FRAMES).bone_length_m[FINGERS])
