"""Hypothesis clustering of simulated people, and the split of clusters."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.clustering.cluster_people import find_poses, reconstruct_by_clustering
from pipeline.association.clustering.clustering_parameters import ClusteringParameters, derive_parameters
from pipeline.association.clustering.instant.candidates import Instant
from pipeline.association.clustering.instant.clusters import find_joints
from pipeline.association.clustering.instant.evidence import Membership
from pipeline.association.clustering.instant.hypotheses import Candidates
from pipeline.association.clustering.instant.work_limits import WorkLimits
from pipeline.association.clustering.skeleton import LimbLengths, clustering_skeleton, unknown_lengths
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Track3D
from pipeline.core.joints import BODY_25, COCO_17, COCO_18, JointSet
from pipeline.geometry.camera import image_from_world
from pipeline.validation.evaluation.simulated import score_simulated
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.cases import slow_but

SKELETON = clustering_skeleton(COCO_17)
EVIDENCE = Membership(SKELETON, 0.3)


def reconstruct(simulation: Simulation) -> tuple[Track3D, ...]:
    return reconstruct_by_clustering(
        simulation.cameras,
        simulation.times,
        simulation.detections,
        simulation.timebase,
        simulation.joints,
        derive_parameters(simulation.cameras),
    )[0]


def two_people(gap_m: float) -> np.ndarray:
    """World positions (people, joints, 3) of two people in T-pose side by side, with hands ``gap_m`` apart."""
    person_m = {
        "neck": (0.0, 0.0, 1.45),
        "nose": (0.1, 0.0, 1.65),
        "shoulder": (0.0, 0.18, 1.45),
        "elbow": (0.0, 0.46, 1.45),
        "wrist": (0.0, 0.71, 1.45),
        "hip": (0.0, 0.1, 0.95),
        "knee": (0.0, 0.1, 0.5),
        "ankle": (0.0, 0.1, 0.08),
        "eye": (0.09, 0.03, 1.7),
        "ear": (0.0, 0.08, 1.68),
    }
    joints_m = np.array([person_m[name.split("_")[-1]] for name in SKELETON.names])
    joints_m[[name.startswith("right") for name in SKELETON.names], 1] *= -1
    apart_m = np.array([0.0, 2 * 0.71 + gap_m, 0.0])
    return np.array([joints_m - apart_m / 2, joints_m + apart_m / 2])


def candidates_of(cameras: tuple[Camera, ...], people_m: np.ndarray, noise_px: float = 0.0) -> Candidates:
    """Exact candidates of all joints of all people in all views; the bodies of a view are the people."""
    rng = np.random.default_rng(4)
    projections = np.array([image_from_world(camera) for camera in cameras])
    in_cam = np.einsum("cij,pkj->cpki", projections[:, :, :3], people_m) + projections[:, None, None, :, 3]
    points_px = in_cam[..., :2] / in_cam[..., 2:]
    view, body, joint = (axis.ravel() for axis in np.indices(points_px.shape[:3]))
    points_px = points_px.reshape(-1, 2) + rng.normal(0.0, noise_px, (len(view), 2)) if noise_px else points_px
    points_px = points_px.reshape(-1, 2)
    return Candidates(joint, view, points_px, points_px, np.full(len(view), 0.9), body)


def known_lengths(people_m: np.ndarray) -> LimbLengths:
    known_m = np.linalg.norm(people_m - people_m[:, list(SKELETON.parents)], axis=-1).T
    known_m[~np.array(SKELETON.is_constant)] = np.nan
    return LimbLengths(known_m, np.array(SKELETON.longest_m))


@pytest.mark.parametrize("scene", slow_but(["handshake"], ["room", "handshake", "unsynchronised"]))
def test_everybody_is_found_and_nobody_else(scene: str) -> None:
    simulation = record(replace(SCENES[scene], duration_s=2.0), seed=11)
    scores = score_simulated(reconstruct(simulation), simulation, simulation.joints)
    assert scores["people_correct"] >= 0.97
    assert scores["switches"] == 0
    assert scores["mpjpe_mm"] < 25.0


def test_perfect_candidates_give_exact_people(ring: tuple[Camera, ...]) -> None:
    people_m = two_people(0.5)
    projections = np.array([image_from_world(camera) for camera in ring])
    parameters = ClusteringParameters(tau1_px=8.0)
    lengths = unknown_lengths(SKELETON)
    candidates = candidates_of(ring, people_m)
    poses = find_poses(projections, Instant(candidates, EVIDENCE), SKELETON, lengths, parameters, WorkLimits())
    order = np.argsort(poses.xyz_m[:, 0, 1])
    np.testing.assert_allclose(poses.xyz_m[order], people_m, atol=1e-4)
    assert (candidates.body[poses.candidate[order]] == np.arange(2)[:, None, None]).all()


def clapping_right_hands(ring: tuple[Camera, ...]) -> list[list[int]]:
    """People whose candidates are behind each found right wrist when two right hands touch."""
    people_m = two_people(0.04)
    # The first person turns around.
    for name in ("shoulder", "elbow", "wrist"):
        sides = SKELETON.indices((f"left_{name}", f"right_{name}"))
        people_m[0, sides] = people_m[0, sides[::-1]]
    wrist = SKELETON.names.index("right_wrist")
    assert np.linalg.norm(people_m[0, wrist] - people_m[1, wrist]) < 0.05
    projections = np.array([image_from_world(camera) for camera in ring])
    candidates = candidates_of(ring, people_m, noise_px=1.0)
    parameters = ClusteringParameters(tau1_px=8.0)
    found = find_joints(projections, candidates, EVIDENCE, SKELETON, known_lengths(people_m), parameters, WorkLimits())
    of_wrists = found.candidate[found.points.joint == wrist]
    return [np.unique(candidates.body[chosen[chosen >= 0]]).tolist() for chosen in of_wrists]


def test_hands_that_clap_belong_to_two_people(ring: tuple[Camera, ...]) -> None:
    """A cluster of wrists with two elbows as parents."""
    assert sorted(clapping_right_hands(ring)) == [[0], [1]]


def test_bone_lengths_tell_whose_joint_it_is(ring: tuple[Camera, ...]) -> None:
    """A false candidate in the true detection in all views, which only the bone length excludes."""
    people_m = two_people(0.5)
    elbow = SKELETON.names.index("left_elbow")
    wrong_m = people_m.copy()
    wrong_m[0, elbow] += [0.0, 0.14, 0.0]
    both = [candidates_of(ring, people_m), candidates_of(ring, wrong_m)]
    both[1] = both[1].where(both[1].joint == elbow)
    candidates = Candidates(*(np.concatenate(pair) for pair in zip(*both, strict=True)))
    candidates.score[-len(both[1].score) :] = 1.0  # the detector prefers the wrong ones
    projections = np.array([image_from_world(camera) for camera in ring])
    parameters = ClusteringParameters(tau1_px=8.0)

    def elbow_error_m(lengths: LimbLengths) -> float:
        poses = find_poses(projections, Instant(candidates, EVIDENCE), SKELETON, lengths, parameters, WorkLimits())
        first = np.argmin(poses.xyz_m[:, 0, 1])
        return float(np.linalg.norm(poses.xyz_m[first, elbow] - people_m[0, elbow]))

    assert elbow_error_m(known_lengths(people_m)) < 0.01
    assert elbow_error_m(unknown_lengths(SKELETON)) > 0.1


@pytest.mark.parametrize("joints", [COCO_17, COCO_18, BODY_25])
def test_tracks_have_detectors_joints(ring: tuple[Camera, ...], joints: JointSet) -> None:
    skeleton = clustering_skeleton(joints)
    people_m = two_people(0.5)
    named_m = dict(zip(SKELETON.names, people_m.swapaxes(0, 1), strict=True))
    known = [name for name in joints.names if name in named_m]
    num_frames = 10
    detections = {}
    for number, camera in enumerate(ring):
        one = candidates_of(ring, people_m)
        mine = one.view == number
        points_px = one.points_px[mine].reshape(2, -1, 2)
        keypoints_px = np.full((2, len(joints.names), 2), np.nan)
        for name in known:
            keypoints_px[:, joints.names.index(name)] = points_px[:, SKELETON.names.index(name)]
        straight = replace(camera, distortion=np.empty(0))
        detections[camera.name] = Detections(
            straight.name,
            np.repeat(np.arange(num_frames), 2),
            np.tile(keypoints_px, (num_frames, 1, 1)),
            np.where(np.isfinite(np.tile(keypoints_px[..., 0], (num_frames, 1))), 0.9, 0.0),
            np.zeros((2 * num_frames, 4)),
        )
    cameras = [replace(camera, distortion=np.empty(0)) for camera in ring]
    times = {camera.name: FrameTimes(np.arange(num_frames) / 25.0) for camera in cameras}
    tracks, observations = reconstruct_by_clustering(
        cameras, times, detections, Timebase(0.0, 25.0, num_frames), joints, derive_parameters(cameras)
    )
    assert [(track.start_frame, track.num_frames) for track in tracks] == [(0, num_frames)] * 2
    tracks = tuple(sorted(tracks, key=lambda track: float(np.nanmean(track.xyz_m[..., 1]))))
    for person, track in enumerate(tracks):
        for name in known:
            expected_m = np.tile(named_m[name][person], (num_frames, 1))
            np.testing.assert_allclose(track.xyz_m[:, joints.names.index(name)], expected_m, atol=1e-4)
        assert track.views[:, joints.names.index("left_knee")].tolist() == [4] * num_frames
    assert observations[0].points_px.shape == (num_frames, 4, len(joints.names), 2)
    assert set(skeleton.names) <= {*joints.names, "neck"}


@pytest.mark.slow
def test_late_person_is_not_suppressed() -> None:
    simulation = record(replace(SCENES["comings-and-goings"], duration_s=8.0), seed=6)
    tracks = reconstruct(simulation)
    late = [track for track in tracks if track.start_frame > 25]
    assert late
    assert all(np.isfinite(track.xyz_m).all(-1).mean() > 0.8 for track in late if track.num_frames > 25)


def test_nobody_anywhere(ring: tuple[Camera, ...]) -> None:
    empty = np.empty((0, 17, 2)), np.empty((0, 17)), np.empty((0, 4))
    detections = {camera.name: Detections(camera.name, np.empty(0, int), *empty) for camera in ring}
    times = {camera.name: FrameTimes(np.arange(5) / 25.0) for camera in ring}
    timebase = Timebase(0.0, 25.0, 5)
    assert reconstruct_by_clustering(ring, times, detections, timebase, COCO_17, derive_parameters(ring)) == ((), ())


def test_detector_without_knees_is_refused() -> None:
    names = tuple(name for name in COCO_17.names if "knee" not in name)
    with pytest.raises(ValueError, match="left_knee, right_knee"):
        clustering_skeleton(JointSet(names, ()))
