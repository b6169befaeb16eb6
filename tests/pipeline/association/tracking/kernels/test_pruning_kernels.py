"""Pairs of target and detection that are skipped: none of them could have been matched."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.association.tracking.kernels import tracking_kernels as kernels
from pipeline.association.tracking.observations import Detections2D, gather, undistorted
from pipeline.association.tracking.tracker import Tracker, make_frames, make_rig
from pipeline.association.tracking.tracking_parameters import TrackingParameters, derive_parameters
from pipeline.core.data.arrays import no_colours
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.geometry.camera import project, rays_in_world
from pipeline.geometry.undistortion import undistort_px
from pipeline.validation.simulation.scenes import SCENES, record
from tests.cases import slow_but
from tests.pipeline.association.tracking import reference
from tests.pipeline.association.tracking.reference import affinity, correspondence_2d, correspondence_3d, predict
from tests.pipeline.conftest import body, ring_camera

NUM_JOINTS = 17
NOW_S = 1.0
RING = tuple(ring_camera(f"cam{k}", 0.3 + k * np.pi / 2) for k in range(4))
PARAMETERS = derive_parameters(RING, 25.0)


def crowd(rng: np.random.Generator, num_people: int, side_m: float, size: float = 1.0) -> np.ndarray:
    """Bodies (people, joints, 3) on a square, also behind cameras if it is large; some joints unknown.

    Boxes around small bodies are apart at distances at which affinities are still positive.
    """
    places_m = np.append(rng.uniform(-side_m, side_m, (num_people, 2)), np.zeros((num_people, 1)), axis=1)
    people_m = size * (body() + rng.normal(0.0, 0.05, (num_people, NUM_JOINTS, 3))) + places_m[:, None]
    people_m[rng.random((num_people, NUM_JOINTS)) < 0.1] = np.nan
    return people_m


def tracker_of(camera: Camera, seen_px: np.ndarray, score: np.ndarray, parameters: TrackingParameters) -> Tracker:
    """Tracker over one frame of a camera."""
    rows = np.zeros(len(seen_px), int)
    bodies = Detections2D(rows, rows, rows + NOW_S, seen_px, score, no_colours())
    frames = make_frames([FrameTimes(np.array([NOW_S]))], bodies, undistorted([camera], bodies), parameters.min_score)
    return Tracker([camera], frames, parameters)


def place_targets(tracker: Tracker, people_m: np.ndarray, shift_m: float, rng: np.random.Generator) -> None:
    """Add targets some way off the people, with joints of different ages; the camera has seen most people before."""
    for person_m in people_m:
        slot = tracker.state._new_slot()
        target = tracker.state._targets.state[slot]
        target["xyz_m"][:, :NUM_JOINTS] = (person_m + rng.normal(0.0, shift_m, 3)).T
        known = np.isfinite(person_m[:, 0])
        ages_s = rng.choice([0.0, 0.04, 0.4, 1.5], NUM_JOINTS, p=[0.4, 0.3, 0.2, 0.1]) * (rng.random() < 0.5)
        target["updated_s"][:NUM_JOINTS][known] = NOW_S - ages_s[known]
        target["velocity_m_s"][:, :NUM_JOINTS] = rng.normal(0.0, 0.1, (3, NUM_JOINTS))
        target["moved_s"] = NOW_S - ages_s[known].min(initial=np.inf)
        if rng.random() < 0.8:
            last_px = project(tracker.state._cameras[0], person_m) + rng.normal(0.0, 0.5, (NUM_JOINTS, 2))
            tracker.state._targets.views[slot, 0]["last_px"][:, :NUM_JOINTS] = last_px.T
            tracker.state._targets.matched_s[slot, 0] = NOW_S - rng.choice([0.04, 0.2])


def all_affinities(tracker: Tracker, camera: Camera, seen_px: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Affinities of all pairs by the reference, (targets, detections)."""
    parameters, targets = tracker.state._parameters, tracker.state._targets
    slots = targets.order[: targets.alive[0]]
    state = targets.state[slots]
    xyz_m = state["xyz_m"][..., :NUM_JOINTS].swapaxes(-1, -2)
    velocity_m_s = state["velocity_m_s"][..., :NUM_JOINTS].swapaxes(-1, -2)
    age_s = NOW_S - state["updated_s"][:, :NUM_JOINTS]
    points_px = np.where(score[..., None] >= parameters.min_score, undistort_px(camera, seen_px), np.nan)
    expected_m = np.array(
        [predict(*one, parameters.max_extrapolation_s) for one in zip(xyz_m, velocity_m_s, age_s, strict=True)]
    )
    last_px = targets.views[slots, 0]["last_px"][..., :NUM_JOINTS].swapaxes(-1, -2)
    with np.errstate(invalid="ignore"):
        terms_2d = correspondence_2d(points_px, last_px, NOW_S - targets.matched_s[slots, 0], parameters)
        center_m = tracker.state._rig.center_m[0]
        terms_3d = correspondence_3d(rays_in_world(camera, points_px), center_m, expected_m, age_s, parameters)
        return affinity(terms_2d, terms_3d)


def listed_pairs(tracker: Tracker, num_detections: int) -> set[tuple[int, int]]:
    """Pairs whose affinities the compiled tracker computes."""
    targets, room, rig = tracker.state._targets, tracker.state._workspace, tracker.state._rig
    kernels.prepare(targets, tracker._frames, 0, num_detections, rig.world_ray_from_image[0])
    num_pairs = kernels.find_pairs(targets, 0, NOW_S, num_detections, rig, tracker.state._limits, room)
    return set(zip(room.pair_target[:num_pairs].tolist(), room.pair_detection[:num_pairs].tolist(), strict=True))


@given(
    seed=st.integers(0, 2**32 - 1),
    num_people=st.integers(1, 12),
    side_m=st.sampled_from([0.3, 1.5, 8.0]),
    size=st.sampled_from([0.05, 1.0]),
    shift_m=st.sampled_from([0.1, 0.2]),
    number=st.integers(0, len(RING) - 1),
    weights=st.sampled_from([(0.4, 0.6), (0.5, 0.5), (0.8, 0.2), (1.0, 0.0), (0.0, 1.0)]),
)
def test_no_skipped_pair_has_positive_affinity(
    seed: int,
    num_people: int,
    side_m: float,
    size: float,
    shift_m: float,
    number: int,
    weights: tuple[float, float],
) -> None:
    rng, camera = np.random.default_rng(seed), RING[number]
    parameters = replace(PARAMETERS, weight_2d=weights[0], weight_3d=weights[1])
    people_m = crowd(rng, num_people, side_m, size)
    seen_px = project(camera, people_m) + rng.normal(0.0, 0.5, (num_people, NUM_JOINTS, 2))
    seen_px[rng.random((num_people, NUM_JOINTS)) < 0.2] = np.nan
    score = np.where(np.isfinite(seen_px[..., 0]), rng.uniform(0.0, 1.0, seen_px.shape[:2]), 0.0)
    tracker = tracker_of(camera, seen_px, score, parameters)
    place_targets(tracker, people_m, shift_m, rng)
    affinities = all_affinities(tracker, camera, seen_px, score)
    positive = set(zip(*(places.tolist() for places in np.nonzero(affinities > 0)), strict=True))
    assert positive <= listed_pairs(tracker, num_people)


@pytest.mark.parametrize("axis", [0, 1])
def test_target_is_skipped_only_out_of_reach(axis: int) -> None:
    """A narrow body, seen where the camera saw it last, while the target moves sideways or up in steps of 1 cm."""
    camera, parameters = RING[0], replace(PARAMETERS, weight_2d=0.5, weight_3d=0.5)
    person_m = 0.02 * body() + np.array([0.0, 0.0, 1.0])
    seen_px, score = project(camera, person_m)[None], np.ones((1, NUM_JOINTS))
    is_positive, is_listed = [], []
    for off_m in np.arange(0.0, 0.4, 0.01):
        tracker = tracker_of(camera, seen_px, score, parameters)
        slot = tracker.state._new_slot()
        target = tracker.state._targets.state[slot]
        target["xyz_m"][:, :NUM_JOINTS] = (person_m + off_m * camera.cam_from_world.rotation[axis]).T
        target["updated_s"][:NUM_JOINTS] = target["moved_s"] = NOW_S
        tracker.state._targets.views[slot, 0]["last_px"][:, :NUM_JOINTS] = undistort_px(camera, seen_px[0]).T
        tracker.state._targets.matched_s[slot, 0] = NOW_S - 0.04
        is_positive.append(bool(all_affinities(tracker, camera, seen_px, score)[0, 0] > 0))
        is_listed.append(bool(listed_pairs(tracker, 1)))
    assert is_positive.index(False) > 25
    assert is_listed.index(False) >= is_positive.index(False)
    assert not is_listed[-1]


def test_most_pairs_of_hall_are_skipped() -> None:
    rng, camera = np.random.default_rng(0), RING[0]
    people_m = crowd(rng, 12, 3.0)
    seen_px = project(camera, people_m)
    score = np.where(np.isfinite(seen_px[..., 0]), 1.0, 0.0)
    tracker = tracker_of(camera, seen_px, score, PARAMETERS)
    place_targets(tracker, people_m, 0.1, rng)
    assert len(listed_pairs(tracker, 12)) < 0.5 * 12 * 12


@pytest.mark.parametrize(
    ("scene", "seed", "duration_s"), slow_but([("crowd", 1, 3.0)], [("crowd", 1, 3.0), ("store-large", 0, 2.0)])
)
def test_people_are_those_of_reference_without_pruning(scene: str, seed: int, duration_s: float) -> None:
    simulation = record(replace(SCENES[scene], duration_s=duration_s), seed, 8)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    bodies = gather(simulation.cameras, simulation.times, simulation.detections)
    times = [simulation.times[camera.name] for camera in simulation.cameras]
    frames = make_frames(times, bodies, undistorted(simulation.cameras, bodies), parameters.min_score)
    plain = reference.ReferenceTracker(simulation.cameras, make_rig(simulation.cameras), frames, parameters)
    identity = Tracker(simulation.cameras, frames, parameters).run()
    np.testing.assert_array_equal(identity, plain.run())
    assert (identity >= 0).any()
