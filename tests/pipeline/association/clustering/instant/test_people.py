"""People from whole bodies: mixed bodies are split, exchanged limbs are put right."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.clustering.cluster_people import Poses, find_poses, reconstruct_by_clustering
from pipeline.association.clustering.clustering_parameters import ClusteringParameters, derive_parameters
from pipeline.association.clustering.instant import people as module
from pipeline.association.clustering.instant.candidates import Instant
from pipeline.association.clustering.instant.evidence import NOWHERE
from pipeline.association.clustering.instant.hypotheses import Candidates
from pipeline.association.clustering.instant.people import match_people
from pipeline.association.clustering.instant.work_limits import MAX_REPAIRS, WorkLimits
from pipeline.association.clustering.skeleton import LimbLengths, unknown_lengths
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import image_from_world
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, accuracy, select_joints
from pipeline.validation.simulation.scenes import SCENES, Scene, record
from tests.cases import slow_but
from tests.pipeline.association.clustering.test_cluster_people import (
    EVIDENCE,
    SKELETON,
    candidates_of,
    known_lengths,
    two_people,
)

PARAMETERS = ClusteringParameters(tau1_px=8.0)
ARM = SKELETON.indices(("left_elbow", "left_wrist"))
PEOPLE_M = two_people(0.2)
LENGTHS = known_lengths(PEOPLE_M)


def poses_of(candidates: Candidates, cameras: tuple[Camera, ...], lengths: LimbLengths = LENGTHS) -> Poses:
    """Poses in the order of ``two_people``."""
    projections = np.array([image_from_world(camera) for camera in cameras])
    poses = find_poses(projections, Instant(candidates, EVIDENCE), SKELETON, lengths, PARAMETERS, WorkLimits())
    order = np.argsort(np.nanmean(poses.xyz_m[..., 1], axis=1))
    return Poses(*(values[order] for values in poses))


def without(candidates: Candidates, view: int, body: int, joints: list[int]) -> Candidates:
    hidden = (candidates.view == view) & (candidates.body == body) & np.isin(candidates.joint, joints)
    return candidates.where(~hidden)


def merged(candidates: Candidates, view: int) -> Candidates:
    """In one view the first body has the left arm of the second one, which is not found."""
    first_arm = (candidates.view == view) & (candidates.body == 0) & np.isin(candidates.joint, ARM)
    second = (candidates.view == view) & (candidates.body == 1)
    kept = candidates.where(~first_arm & ~(second & ~np.isin(candidates.joint, ARM)))
    return kept._replace(body=np.where(kept.view == view, 0, kept.body))


@pytest.mark.parametrize("num_cameras", [3, 4])
def test_merged_body_is_split(ring: tuple[Camera, ...], num_cameras: int) -> None:
    candidates = merged(candidates_of(ring[:num_cameras], PEOPLE_M, noise_px=0.5), view=1)
    poses = poses_of(candidates, ring[:num_cameras])
    assert len(poses.xyz_m) == 2
    np.testing.assert_allclose(poses.xyz_m, PEOPLE_M, atol=0.03)
    # In the merged body's view the arm is the second person's, and the rest is the first person's.
    assert (poses.candidate[0, ARM, 1] == NOWHERE).all()
    assert (poses.candidate[1, ARM, 1] != NOWHERE).all()
    rest = np.setdiff1d(np.arange(len(SKELETON.names)), ARM)
    assert (poses.candidate[0, rest, 1] != NOWHERE).all()
    assert (poses.candidate[1, rest, 1] == NOWHERE).all()


@pytest.mark.parametrize("part", ["arms", "legs"])
@pytest.mark.parametrize("view", [0, 1, 2])
def test_left_and_right_that_view_exchanges_are_put_right(ring: tuple[Camera, ...], part: str, view: int) -> None:
    names = ("shoulder", "elbow", "wrist") if part == "arms" else ("hip", "knee", "ankle")
    left, right = (SKELETON.indices(tuple(f"{side}_{name}" for name in names)) for side in ("left", "right"))
    candidates = candidates_of(ring[:3], PEOPLE_M, noise_px=0.5)
    exchanged = np.arange(len(SKELETON.names))
    exchanged[left + right] = right + left
    here = (candidates.view == view) & (candidates.body == 1)
    wrong = candidates._replace(joint=np.where(here, exchanged[candidates.joint], candidates.joint))
    poses = poses_of(wrong, ring[:3])
    np.testing.assert_allclose(poses.xyz_m, PEOPLE_M, atol=0.03)
    assert (poses.candidate != NOWHERE).all()


def test_three_joints_in_two_views_are_person_and_two_are_none(ring: tuple[Camera, ...]) -> None:
    candidates = candidates_of(ring[:2], PEOPLE_M, noise_px=0.5)
    leg = SKELETON.indices(("left_hip", "left_knee", "left_ankle"))
    is_hidden = (candidates.body == 1) & ~np.isin(candidates.joint, leg)
    poses = poses_of(candidates.where(~is_hidden), ring[:2])
    np.testing.assert_allclose(poses.xyz_m[1][leg], PEOPLE_M[1][leg], atol=0.03)
    assert np.isnan(np.delete(poses.xyz_m[1], leg, axis=0)).all()
    is_hidden |= (candidates.body == 1) & (candidates.joint == leg[0])
    assert len(poses_of(candidates.where(~is_hidden), ring[:2]).xyz_m) == 1


def test_person_without_neck_in_three_views_is_found(ring: tuple[Camera, ...]) -> None:
    """Each view lacks a shoulder, and with it the neck, from which the paper's steps start."""
    left, right = ([0, joint] for joint in SKELETON.shoulders)
    candidates = candidates_of(ring[:3], PEOPLE_M)
    for view, joints in ((0, left), (1, left), (2, right)):
        candidates = without(candidates, view, 0, joints)
    poses = poses_of(candidates, ring[:3])
    known = np.isfinite(poses.xyz_m[0, :, 0])
    # The left shoulder is in one view only, and the neck lies between the shoulders.
    assert np.flatnonzero(~known).tolist() == [0, SKELETON.shoulders[0]]
    np.testing.assert_allclose(poses.xyz_m[0, known], PEOPLE_M[0, known], atol=1e-4)
    np.testing.assert_allclose(poses.xyz_m[1], PEOPLE_M[1], atol=1e-4)


def test_papers_steps_find_who_has_no_bodies_to_match(ring: tuple[Camera, ...]) -> None:
    """Every joint of the second person is a body of its own."""
    candidates = candidates_of(ring, PEOPLE_M)
    alone = np.where(candidates.body == 1, 100 + candidates.joint, 0)
    candidates = candidates._replace(body=alone)
    projections = np.array([image_from_world(camera) for camera in ring])
    whole = match_people(projections, candidates, SKELETON, LENGTHS, PARAMETERS, WorkLimits())
    np.testing.assert_allclose(whole.joints.points.xyz_m[whole.joint_of], PEOPLE_M[:1], atol=1e-4)
    lenient = ClusteringParameters(tau1_px=8.0, use_connectivity=False)
    poses = find_poses(projections, Instant(candidates, EVIDENCE), SKELETON, LENGTHS, lenient, WorkLimits())
    assert len(poses.xyz_m) == 2
    np.testing.assert_allclose(poses.xyz_m[poses.xyz_m[:, 0, 1].argmax()], PEOPLE_M[1], atol=1e-4)


def test_candidates_without_bodies_are_left_to_papers_steps(ring: tuple[Camera, ...]) -> None:
    candidates = candidates_of(ring, PEOPLE_M)
    candidates = candidates._replace(body=np.full(len(candidates.body), NOWHERE))
    projections = np.array([image_from_world(camera) for camera in ring])
    whole = match_people(projections, candidates, SKELETON, LENGTHS, PARAMETERS, WorkLimits())
    assert len(whole.joint_of) == len(whole.joints.points.joint) == 0


def test_repairs_beyond_limit_are_left_out(ring: tuple[Camera, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    candidates = merged(candidates_of(ring, PEOPLE_M), view=1)
    projections = np.array([image_from_world(camera) for camera in ring])
    for most, is_exact in ((MAX_REPAIRS, True), (4, False)):
        monkeypatch.setattr(module, "MAX_REPAIRS", most)
        limits = WorkLimits()
        whole = match_people(projections, candidates, SKELETON, unknown_lengths(SKELETON), PARAMETERS, limits)
        assert limits.is_exact == is_exact
        assert len(whole.joint_of) == 2


def recall_within_150_mm(scene: Scene, seed: int, num_views: int) -> tuple[float, float]:
    """Share of true people in all frames whose pose, and share of true joints that, is within 150 mm."""
    simulation = record(scene, seed, num_views)
    parameters = derive_parameters(simulation.cameras)
    views = (simulation.cameras, simulation.times, simulation.detections, simulation.timebase)
    tracks, _ = reconstruct_by_clustering(*views, simulation.joints, parameters)
    frames = np.arange(simulation.timebase.num_frames)
    predicted_m = select_joints(tracks, simulation.joints, BODY_JOINTS, frames)
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(BODY_JOINTS)]
    scores = accuracy(predicted_m, truth_m, gate_m=0.15)
    assert scores.recall is not None
    assert scores.pck150 is not None
    return scores.recall, scores.pck150


@pytest.mark.parametrize("name", slow_but(["noisy"], ["crowd-3", "noisy"]))
def test_people_are_found_with_three_cameras(name: str) -> None:
    recall, pck150 = recall_within_150_mm(replace(SCENES[name], duration_s=2.0), 5, num_views=3)
    assert recall >= 0.97
    assert pck150 >= 0.93
