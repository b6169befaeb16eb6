"""Match of whole bodies across views."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.instant import bodies as module
from pipeline.association.clustering.instant.bodies import (
    agree,
    collect_bodies,
    join_bodies,
    least_agreement,
    match_bodies,
)
from pipeline.association.clustering.instant.hypotheses import Candidates
from pipeline.association.clustering.instant.work_limits import WorkLimits
from pipeline.association.clustering.skeleton import LimbLengths, unknown_lengths
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import image_from_world
from tests.pipeline.association.clustering.test_cluster_people import SKELETON, candidates_of, known_lengths, two_people

PARAMETERS = ClusteringParameters(tau1_px=8.0)
UNKNOWN = unknown_lengths(SKELETON)


def people_of(candidates: Candidates, cameras: tuple[Camera, ...], lengths: LimbLengths = UNKNOWN) -> list[list[int]]:
    """Detection of each person in each view, -1 for none, sorted."""
    projections = np.array([image_from_world(camera) for camera in cameras])
    bodies = collect_bodies(candidates, len(SKELETON.names))
    matched = match_bodies(projections, candidates, bodies, SKELETON, lengths, PARAMETERS, WorkLimits())
    number = candidates.body[bodies.candidate.max(-1)]
    return sorted(np.where(matched >= 0, number[matched], -1).tolist())


def without(candidates: Candidates, view: int, body: int) -> Candidates:
    return candidates.where((candidates.view != view) | (candidates.body != body))


def test_bodies_of_person_are_matched_in_all_views(ring: tuple[Camera, ...]) -> None:
    candidates = candidates_of(ring, two_people(0.2), noise_px=2.0)
    assert people_of(candidates, ring) == [[0, 0, 0, 0], [1, 1, 1, 1]]
    assert people_of(without(candidates, 2, 0), ring) == [[0, 0, -1, 0], [1, 1, 1, 1]]


def test_bodies_of_different_people_are_nobody(ring: tuple[Camera, ...]) -> None:
    """One camera sees the first person only, another one the second person only."""
    candidates = candidates_of(ring[:2], two_people(0.2))
    assert people_of(without(without(candidates, 0, 1), 1, 0), ring[:2]) == []


def test_body_that_is_found_twice_is_matched_once(ring: tuple[Camera, ...]) -> None:
    candidates = candidates_of(ring, two_people(0.2))
    again = candidates.where((candidates.view == 1) & (candidates.body == 0))
    copy = again._replace(body=np.full(len(again.body), 7), score=0.5 * again.score)
    both = Candidates(*(np.concatenate(pair) for pair in zip(candidates, copy, strict=True)))
    assert people_of(both, ring) == [[0, 0, 0, 0], [1, 1, 1, 1]]


def test_bone_lengths_tell_bodies_apart(ring: tuple[Camera, ...]) -> None:
    """Two views agree on a person of another size: an upper arm that is half as long again belongs to nobody."""
    people_m = two_people(0.5)[:1]
    lengths = known_lengths(people_m)
    people_m[:, SKELETON.indices(("left_elbow", "right_elbow"))] += [[0.0, 0.14, 0.0], [0.0, -0.14, 0.0]]
    candidates = candidates_of(ring[:2], people_m)
    projections = np.array([image_from_world(camera) for camera in ring[:2]])
    bodies = collect_bodies(candidates, len(SKELETON.names))

    def agreement(known: LimbLengths) -> float:
        return float(agree(projections, candidates, bodies, SKELETON, known, PARAMETERS, WorkLimits())[0, 1])

    # The elbows and the wrists, each with the score 0.9, change sides.
    assert agreement(UNKNOWN) == pytest.approx(0.9 * (len(SKELETON.names) - 1), abs=1e-6)
    assert agreement(lengths) == pytest.approx(agreement(UNKNOWN) - 2 * 0.9 * 4, abs=1e-6)


def test_joints_behind_camera_speak_against_pair(ring: tuple[Camera, ...]) -> None:
    people_m = two_people(0.2)[:1]
    behind = replace(ring[0], cam_from_world=replace(ring[0].cam_from_world))
    turned = np.diag([1.0, -1.0, -1.0]) @ behind.cam_from_world.rotation  # half a turn about the image's x axis
    behind = replace(behind, cam_from_world=replace(behind.cam_from_world, rotation=turned))
    shift = -turned @ (-ring[0].cam_from_world.rotation.T @ ring[0].cam_from_world.translation_m)
    behind = replace(behind, cam_from_world=replace(behind.cam_from_world, translation_m=shift))
    assert people_of(candidates_of((behind, ring[1]), people_m), (behind, ring[1])) == []


def symmetric(values: list[float]) -> np.ndarray:
    """Agreement of four bodies from the six values of their pairs."""
    total = np.zeros((4, 4))
    total[np.triu_indices(4, 1)] = values
    return total + total.T


def test_all_pairs_of_group_count() -> None:
    """The second body agrees with both of its neighbours, who contradict each other."""
    chain = symmetric([9.0, -20.0, 0.0, 8.0, 0.0, 0.0])
    assert join_bodies(chain, 1.5).tolist() == [0, 0, 2, 3]
    assert len(set(join_bodies(symmetric([9.0, -5.0, 0.0, 8.0, 0.0, 0.0]), 1.5)[:3].tolist())) == 1


@given(
    values=st.lists(st.floats(-5.0, 5.0), min_size=6, max_size=6, unique=True),
    views=st.lists(st.integers(0, 2), min_size=4, max_size=4),
    order=st.permutations(range(4)),
)
def test_groups_keep_views_apart_and_do_not_depend_on_order(
    values: list[float], views: list[int], order: list[int]
) -> None:
    view = np.array(views)
    agreement = np.where(view[:, None] == view, -np.inf, symmetric(values))
    group = join_bodies(agreement, 1.5)
    together = group[:, None] == group
    assert not np.any(together & (view[:, None] == view) & ~np.eye(4, dtype=bool))
    permuted = join_bodies(agreement[np.ix_(order, order)], 1.5)
    np.testing.assert_array_equal(permuted[:, None] == permuted, together[np.ix_(order, order)])


@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_joints_count_as_much_as_views_score(ring: tuple[Camera, ...], scale: float) -> None:
    """Bodies of three joints each, by detectors of different scales."""
    candidates = candidates_of(ring[:3], two_people(0.2), noise_px=1.0)
    few = candidates.where(np.isin(candidates.joint, SKELETON.indices(("left_hip", "left_knee", "left_ankle"))))
    assert people_of(few._replace(score=scale * few.score), ring[:3]) == [[0, 0, 0], [1, 1, 1]]


def test_more_bodies_need_more_joints_that_agree(ring: tuple[Camera, ...]) -> None:
    candidates = candidates_of(ring[:3], two_people(0.2))

    def least(num_copies: int) -> float:
        """Least agreement, in joints, if each body is there some times."""
        copies = [candidates._replace(body=candidates.body + 2 * copy) for copy in range(num_copies)]
        crowd = Candidates(*(np.concatenate(parts) for parts in zip(*copies, strict=True)))
        return least_agreement(crowd, collect_bodies(crowd, len(SKELETON.names))) / 0.9

    assert least(1) == pytest.approx(1.5)
    # 400 pairs of bodies in two views, each with the chance 0.05 a joint.
    assert least(10) == pytest.approx(np.log(4000.0) / np.log(20.0))


def test_limits_leave_bodies_out_and_say_so(ring: tuple[Camera, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    candidates = candidates_of(ring, two_people(0.2))
    projections = np.array([image_from_world(camera) for camera in ring])
    bodies = collect_bodies(candidates, len(SKELETON.names))

    def matched() -> tuple[int, bool]:
        limits = WorkLimits()
        people = match_bodies(projections, candidates, bodies, SKELETON, UNKNOWN, PARAMETERS, limits)
        return int((people >= 0).sum()), limits.is_exact

    assert matched() == (8, True)
    monkeypatch.setattr(module, "MAX_PAIRS", 23)
    assert matched() == (8, False)
    monkeypatch.setattr(module, "MAX_BODIES", 7)
    assert matched() == (0, False)
