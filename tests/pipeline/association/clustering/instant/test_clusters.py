"""DBSCAN of hypotheses: the clusters of a brute-force reference, kinds apart, and cells in hostile crowds."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.association.clustering.clustering_parameters import derive_parameters
from pipeline.association.clustering.instant import work_limits
from pipeline.association.clustering.instant.candidates import BodyEvidence
from pipeline.association.clustering.instant.clusters import cluster_hypotheses
from pipeline.association.clustering.instant.hypotheses import meet
from pipeline.association.clustering.instant.work_limits import WorkLimits
from pipeline.association.clustering.skeleton import clustering_skeleton
from pipeline.geometry.camera import image_from_world
from pipeline.validation.simulation.scenes import simulate

EPS_M = 0.1
ON_GRID = st.integers(-4, 4).map(lambda step: step / 16)  # distances are exact: none is nearly eps


def clusters_of(xyz_m: np.ndarray, joint: np.ndarray, limits: WorkLimits | None = None) -> list[list[int]]:
    return [members.tolist() for members in cluster_hypotheses(xyz_m, joint, EPS_M, limits or WorkLimits())]


def reference_clusters(xyz_m: np.ndarray, joint: np.ndarray) -> list[list[int]]:
    """Clusters by flooding from each point that has no cluster yet, with all distances."""
    near = np.linalg.norm(xyz_m[:, None] - xyz_m[None], axis=-1) <= EPS_M
    near &= joint[:, None] == joint
    left, clusters = set(range(len(joint))), []
    while left:
        members, border = set(), {min(left)}
        while border:
            members |= border
            border = {int(row) for member in border for row in np.flatnonzero(near[member])} - members
        clusters.append(sorted(members))
        left -= members
    return clusters


@given(st.data(), st.integers(0, 40))
def test_clusters_are_those_of_brute_force(data: st.DataObject, num_points: int) -> None:
    xyz_m = data.draw(arrays(float, (num_points, 3), elements=ON_GRID))
    joint = data.draw(arrays(int, num_points, elements=st.integers(0, 2)))
    assert clusters_of(xyz_m, joint) == reference_clusters(xyz_m, joint)


@pytest.mark.parametrize("scene", ["room", "walk", "store"])
def test_clusters_of_simulated_instants_are_those_of_brute_force(scene: str) -> None:
    simulation = simulate(scene, 3, 4)
    skeleton, parameters = clustering_skeleton(simulation.joints), derive_parameters(simulation.cameras)
    projections = np.array([image_from_world(camera) for camera in simulation.cameras])
    evidence = BodyEvidence(
        simulation.cameras, simulation.times, simulation.detections, simulation.timebase, skeleton, parameters
    )
    num_joined = 0
    for frame in range(0, simulation.timebase.num_frames, simulation.timebase.num_frames // 5):
        candidates = evidence.at(frame).candidates
        hypotheses = meet(projections, candidates, parameters.tau1_px, WorkLimits())
        joint = candidates.joint[hypotheses.pair[:, 0]]
        clusters = clusters_of(hypotheses.xyz_m, joint)
        assert clusters == reference_clusters(hypotheses.xyz_m, joint)
        num_joined += sum(len(members) > 2 for members in clusters)
    assert num_joined > 20


def chain(num_points: int, step_m: float) -> np.ndarray:
    return np.column_stack([step_m * np.arange(num_points), np.zeros((num_points, 2))])


def test_chain_of_neighbours_is_cluster() -> None:
    together = chain(30, 0.99 * EPS_M)
    assert clusters_of(together, np.zeros(30, int)) == [list(range(30))]
    assert clusters_of(chain(30, 1.01 * EPS_M), np.zeros(30, int)) == [[row] for row in range(30)]


def test_joints_of_different_kinds_are_never_together() -> None:
    assert clusters_of(np.zeros((4, 3)), np.array([0, 1, 0, 1])) == [[0, 2], [1, 3]]


def test_too_many_neighbours_are_clustered_by_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work_limits, "MAX_NEIGHBOURS", 100)
    rng = np.random.default_rng(1)
    xyz_m = np.concatenate([rng.uniform(0, 0.04, (40, 3)), 2 + rng.uniform(0, 0.04, (40, 3))])
    joint = np.arange(80) % 2
    limits = WorkLimits()
    assert not_in_order(clusters_of(xyz_m, joint, limits)) == not_in_order(reference_clusters(xyz_m, joint))
    assert not limits.is_exact
    exact = WorkLimits()
    clusters_of(xyz_m[:10], joint[:10], exact)
    assert exact.is_exact


def not_in_order(clusters: Sequence[list[int]]) -> set[tuple[int, ...]]:
    """Clusters without their order, which cells change."""
    return {tuple(members) for members in clusters}
