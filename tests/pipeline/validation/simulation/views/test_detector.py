"""Simulated detector: exact without noise, and rates of its faults."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.core.joints import COCO_17
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.motion.performance import joints_at, perform
from pipeline.validation.simulation.motion.script import Gesture, Role, Stay
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from pipeline.validation.simulation.views.detector import PERFECT, UNASSIGNED, DetectorAccuracy, detect
from pipeline.validation.simulation.views.faults import (
    NO_FAULTS,
    Faults,
    heavy_tailed,
    lasting_events,
    lasting_noise,
    neighbours,
)
from pipeline.validation.simulation.views.occlusion import hidden_by_bodies

NUM_FRAMES = 4000
NOISELESS = replace(PERFECT, faults=NO_FAULTS)


def camera() -> Camera:
    return build_cameras(Rig(Layout.RING, 4, (5.0, 5.0), 2.0), np.random.default_rng(4))[0]


def crowd(*places: tuple[float, float], num_frames: int = NUM_FRAMES) -> np.ndarray:
    """World positions of people who stand and talk."""
    people = [
        perform(Role(place, 0.0, (Stay(20.0, Gesture.TALK),)), 20.0, np.random.default_rng(number))
        for number, place in enumerate(places)
    ]
    return np.stack([joints_at(person, np.linspace(1.0, 19.0, num_frames)) for person in people])


def run(people_m: np.ndarray, detector: DetectorAccuracy, seed: int = 1) -> tuple[Detections, np.ndarray]:
    return detect(camera(), 0.04, people_m, (), detector, np.random.default_rng(seed))


def with_faults(**rates: float) -> DetectorAccuracy:
    return replace(PERFECT, faults=replace(NO_FAULTS, **rates))


SIDE_BY_SIDE = crowd((0.0, -1.2), (0.0, 1.2))
CLOSE = crowd((0.0, -0.2), (0.0, 0.2))


def test_without_noise_detections_are_projections() -> None:
    detections, identity = run(SIDE_BY_SIDE, NOISELESS)
    assert len(detections.frame) == 2 * NUM_FRAMES
    expected = project(camera(), SIDE_BY_SIDE)[identity, detections.frame]
    np.testing.assert_allclose(detections.keypoints_px, expected, atol=1e-9)
    assert (np.diff(detections.frame) >= 0).all()
    np.testing.assert_allclose(detections.box_px[:, :2], expected.min(1))
    np.testing.assert_allclose(detections.box_px[:, 2:], expected.max(1))
    # The order in a frame tells nobody's identity.
    assert 0.4 < (identity[::2] == 0).mean() < 0.6


def test_noise_has_size_asked_for_and_heavy_tails() -> None:
    detections, identity = run(SIDE_BY_SIDE, replace(NOISELESS, noise_m=0.0, noise_px=3.0))
    error_px = detections.keypoints_px - project(camera(), SIDE_BY_SIDE)[identity, detections.frame]
    visible = detections.score > 0.45
    deviation_px = np.array([error_px[visible[:, joint], joint].std() for joint in range(17)])
    assert deviation_px.mean() == pytest.approx(3.0, rel=0.1)
    assert deviation_px[COCO_17.index("left_hip")] > 3 * deviation_px[COCO_17.index("nose")]
    shoulder_px = error_px[:, COCO_17.index("left_shoulder"), 0]
    assert (np.abs(shoulder_px) > 4 * shoulder_px.std()).mean() > 3 * 6.3e-5


def along_the_view(near_m: float, far_m: float, aside_m: float) -> np.ndarray:
    """A person between the camera and the centre, and a person beyond the centre."""
    center_m = center_in_world(camera())[:2]
    towards = center_m / np.linalg.norm(center_m)
    aside = aside_m * np.array([-towards[1], towards[0]])
    near, far = near_m * towards + aside, -far_m * towards - aside
    return crowd((float(near[0]), float(near[1])), (float(far[0]), float(far[1])))


def test_noise_is_share_of_body() -> None:
    people_m = along_the_view(1.0, 4.0, aside_m=0.6)
    detections, identity = run(people_m, replace(NOISELESS, noise_m=0.01, hidden_noise=1.0))
    error_px = detections.keypoints_px - project(camera(), people_m)[identity, detections.frame]
    spread_px = [error_px[identity == person].std() for person in (0, 1)]
    height_px = [np.median(np.ptp(detections.box_px[identity == person][:, 1::2], axis=1)) for person in (0, 1)]
    assert height_px[0] > 1.8 * height_px[1]
    assert spread_px[0] / spread_px[1] == pytest.approx(height_px[0] / height_px[1], rel=0.2)


def test_scores_fall_with_error() -> None:
    detections, identity = run(SIDE_BY_SIDE, replace(NOISELESS, noise_m=0.03))
    error_px = detections.keypoints_px - project(camera(), SIDE_BY_SIDE)[identity, detections.frame]
    error_px, score = np.linalg.norm(error_px, axis=-1)[:, 5:].ravel(), detections.score[:, 5:].ravel()
    assert np.corrcoef(error_px, score)[0, 1] < -0.5
    assert score.min() >= 0.0
    assert score.max() <= 1.0


def test_hidden_joints_score_less_and_are_worse_or_missing() -> None:
    people_m = along_the_view(1.0, 2.0, aside_m=0.08)
    detector = replace(PERFECT, noise_m=0.01, hidden_missing=0.4, hidden_noise=4.0)
    detections, identity = run(people_m, detector)
    hidden = hidden_by_bodies(camera().cam_from_world.apply(people_m))[identity, detections.frame]
    error_px = np.linalg.norm(
        detections.keypoints_px - project(camera(), people_m)[identity, detections.frame], axis=-1
    )
    assert hidden[identity == 1].mean() > 0.2
    assert (detections.score[hidden] == 0).mean() == pytest.approx(0.4, abs=0.02)
    assert (detections.score[~hidden] > 0).all()
    assert np.median(detections.score[hidden & (detections.score > 0)]) < 0.5 < np.median(detections.score[~hidden])
    shoulders = COCO_17.indices(("left_shoulder", "right_shoulder"))
    worse = np.nanmedian(error_px[:, shoulders][hidden[:, shoulders]])
    better = np.nanmedian(error_px[identity == 1][:, shoulders][~hidden[identity == 1][:, shoulders]])
    assert worse / better == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize("rate", [0.05, 0.2])
def test_bodies_are_missed_at_rate(rate: float) -> None:
    detections, _ = run(SIDE_BY_SIDE, with_faults(miss_body=rate, memory_s=0.0))
    assert len(detections.frame) / (2 * NUM_FRAMES) == pytest.approx(1 - rate, abs=0.015)


def test_misses_come_in_runs() -> None:
    detections, identity = run(SIDE_BY_SIDE, with_faults(miss_body=0.2, memory_s=0.4))
    missed = np.ones(NUM_FRAMES, dtype=bool)
    missed[detections.frame[identity == 0]] = False
    num_runs = int(np.sum(np.diff(missed.astype(int)) == 1))
    assert missed.sum() / num_runs > 2.0


def test_joints_are_missed_at_rate() -> None:
    detections, _ = run(SIDE_BY_SIDE, with_faults(miss_joint=0.1))
    missing = detections.score == 0
    assert missing.mean() == pytest.approx(0.1, abs=0.01)
    np.testing.assert_array_equal(missing, np.isnan(detections.keypoints_px).any(-1))


def test_limbs_are_swapped_at_rate() -> None:
    detections, identity = run(SIDE_BY_SIDE, with_faults(swap=0.1, memory_s=0.0))
    truth_px = project(camera(), SIDE_BY_SIDE)[identity, detections.frame]
    mirrored = [COCO_17.index(name.replace("left", "right")) for name in COCO_17.names if "left" in name]
    original = [COCO_17.index(name) for name in COCO_17.names if "left" in name]
    wrong = np.abs(detections.keypoints_px - truth_px).max(-1) > 1e-6
    assert wrong.any(1).mean() == pytest.approx(0.1, abs=0.015)
    swapped_to = truth_px[:, mirrored]
    rows, joints = np.nonzero(wrong[:, original])
    np.testing.assert_allclose(detections.keypoints_px[:, original][rows, joints], swapped_to[rows, joints])
    assert not wrong[:, :5].any()


def test_close_people_mix_at_rate_and_others_never() -> None:
    detector = with_faults(mix=0.2, memory_s=0.0)
    detections, identity = run(CLOSE, detector)
    truth_px = project(camera(), CLOSE)
    wrong = np.abs(detections.keypoints_px - truth_px[identity, detections.frame]).max(-1) > 1e-6
    mixed = wrong.any(1)
    other_px = truth_px[1 - identity, detections.frame]
    np.testing.assert_allclose(detections.keypoints_px[wrong], other_px[wrong])
    assert mixed.sum() / (2 * NUM_FRAMES) == pytest.approx(0.2, abs=0.03)
    # A limb each; half of the victims that take nothing themselves are gone: 0.2 * 0.8 / 2.
    assert set(np.sum(wrong[mixed], axis=1).tolist()) == {2}
    assert 1 - len(identity) / (2 * NUM_FRAMES) == pytest.approx(0.08, abs=0.08)
    apart, who = run(SIDE_BY_SIDE, detector)
    np.testing.assert_allclose(apart.keypoints_px, project(camera(), SIDE_BY_SIDE)[who, apart.frame])


def test_duplicates() -> None:
    detections, identity = run(SIDE_BY_SIDE, with_faults(duplicate=0.1))
    assert len(identity) / (2 * NUM_FRAMES) == pytest.approx(1.1, abs=0.02)
    key = detections.frame * 2 + identity
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    assert count.max() == 2
    assert len(first) == 2 * NUM_FRAMES


def test_false_positives_are_nobody_and_score_low() -> None:
    detections, identity = run(SIDE_BY_SIDE, with_faults(false_positives=0.3, memory_s=0.2))
    ghosts = identity == UNASSIGNED
    assert ghosts.sum() / NUM_FRAMES == pytest.approx(0.3, abs=0.06)
    assert detections.score[ghosts].max() <= 0.5
    assert ((detections.score[ghosts] > 0).sum(1) >= 1).all()
    size_px = np.array(camera().size_px)
    known = detections.keypoints_px[ghosts][detections.score[ghosts] > 0]
    assert ((known >= 0) & (known <= size_px - 1)).all()


def test_absent_person_is_not_found() -> None:
    people_m = SIDE_BY_SIDE[:, :100].copy()
    people_m[0, :50] = np.nan
    people_m[1] += np.array([0.0, 0.0, 30.0])
    detections, identity = run(people_m, NOISELESS)
    assert set(identity.tolist()) == {0}
    np.testing.assert_array_equal(detections.frame, np.arange(50, 100))


def test_nobody_at_all() -> None:
    detections, identity = run(np.full((2, 10, 17, 3), np.nan), DetectorAccuracy(faults=NO_FAULTS))
    assert len(identity) == 0
    assert detections.keypoints_px.shape == (0, 17, 2)
    assert detections.box_px.shape == (0, 4)


def test_same_seed_same_detections() -> None:
    detector = DetectorAccuracy(faults=Faults(false_positives=0.2))
    first, second, other = (run(CLOSE[:, :200], detector, seed) for seed in (5, 5, 6))
    assert first[0].keypoints_px.tobytes() == second[0].keypoints_px.tobytes()
    assert first[1].tobytes() == second[1].tobytes()
    assert first[0].keypoints_px.tobytes() != other[0].keypoints_px.tobytes()


def test_neighbours_are_near_and_mutual_for_two() -> None:
    in_sight = np.ones((2, 10), dtype=bool)
    near = neighbours(project(camera(), CLOSE[:, :10]), in_sight)
    np.testing.assert_array_equal(near, np.array([[1], [0]]) * np.ones((2, 10), dtype=int))
    assert (neighbours(project(camera(), SIDE_BY_SIDE[:, :10]), in_sight) == -1).all()
    in_sight[1] = False
    assert (neighbours(project(camera(), CLOSE[:, :10]), in_sight)[0] == -1).all()


@pytest.mark.parametrize("memory", [0.0, 5.0])
def test_lasting_noise_is_stationary(memory: float) -> None:
    noise = lasting_noise(np.random.default_rng(1), (20000, 40), memory)
    np.testing.assert_allclose(noise.std(0), 1.0, atol=0.08)
    correlation = (noise[:, 1:] * noise[:, :-1]).mean()
    assert correlation == pytest.approx(np.exp(-1 / memory) if memory else 0.0, abs=0.02)


@pytest.mark.parametrize("rate", [0.0, 0.03, 0.5, 1.0])
def test_lasting_events_hold_at_rate(rate: float) -> None:
    events = lasting_events(np.random.default_rng(1), (500, 200), rate, 4.0)
    assert events.mean() == pytest.approx(rate, abs=0.02 if 0 < rate < 1 else 0.0)


def test_heavy_tails_have_unit_variance() -> None:
    noise = heavy_tailed(np.random.default_rng(1), (200000,), 5.0)
    assert noise.std() == pytest.approx(1.0, abs=0.03)
