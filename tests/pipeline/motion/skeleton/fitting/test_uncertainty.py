"""Uncertainty of joints: agreement with true errors in simulation, and with what is seen."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.animation import Animation
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import COCO_17, MARKED_AT_CENTERS, JointOffset
from pipeline.core.options.config import ReconstructionConfig, Smoothing
from pipeline.geometry.camera import project
from pipeline.motion.skeleton import time_series
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.fitting.articulation import Articulation, articulate
from pipeline.motion.skeleton.fitting.gauss_newton import JointPoses, Posed, start_from
from pipeline.motion.skeleton.fitting.landmark_evidence import LandmarkEvidence
from pipeline.motion.skeleton.fitting.rays import Rays
from pipeline.motion.skeleton.fitting.uncertainty import (
    _FLOOR_M,
    _INERTIA,
    NETWORK_LASTING,
    SIMULATED_LASTING,
    _priors,
    disagreement_m,
    uncertainty_m,
)
from pipeline.motion.skeleton.model import SKELETON
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, match_frames, select_joints
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.cases import slow_but

RATE_HZ = 25.0


@cache
def taken(
    scene: str, num_views: int | None = None, duration_s: float = 6.0
) -> tuple[Simulation, tuple[tuple[Track3D, ...], tuple[Observations, ...]]]:
    simulation = record(replace(find_scene(scene), duration_s=duration_s), 5, num_views)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    return simulation, reconstruct_tracks(
        simulation.cameras, simulation.times, simulation.detections, simulation.timebase, parameters
    )


@cache
def animated(scene: str, num_views: int | None = None, smoothing: Smoothing = "fit") -> Animation:
    simulation, found = taken(scene, num_views)
    config = ReconstructionConfig(smoothing=smoothing)
    return animate(*found, simulation.cameras, simulation.timebase, simulation.joints, config)


def errors(scene: str, num_views: int | None) -> tuple[np.ndarray, np.ndarray]:
    """True errors of the twelve joints (metres, root mean square over the axes), and their uncertainty."""
    simulation, animation = taken(scene, num_views)[0], animated(scene, num_views)
    frames, columns = np.arange(simulation.timebase.num_frames), COCO_17.indices(BODY_JOINTS)
    truth_m = simulation.truth_m[:, :, columns]
    found_m = select_joints(animation.tracks, COCO_17, BODY_JOINTS, frames)
    sigma_m = np.full(found_m.shape[:3], np.nan)
    for number, track in enumerate(animation.tracks):
        assert track.uncertainty_m is not None
        rows = slice(track.start_frame, track.start_frame + track.num_frames)
        sigma_m[number, rows] = track.uncertainty_m[:, columns]
    matched = match_frames(found_m, truth_m)
    error_m = np.linalg.norm(found_m[matched, frames] - truth_m, axis=-1) / np.sqrt(3)
    stated_m = sigma_m[matched, frames]
    known = np.isfinite(error_m) & (matched >= 0)[..., None]
    assert np.isfinite(stated_m[known]).all()
    return error_m[known], stated_m[known]


@pytest.mark.parametrize(
    ("scene", "num_views"),
    slow_but([("room", None)], [("room", None), ("room", 3), ("store", None), ("noisy", None)]),
)
def test_errors_are_as_large_as_stated(scene: str, num_views: int | None) -> None:
    error_m, stated_m = errors(scene, num_views)
    assert 0.7 < np.sqrt(np.mean((error_m / stated_m) ** 2)) < 1.5
    doubtful = stated_m >= np.quantile(stated_m, 0.9)
    certain = stated_m <= np.quantile(stated_m, 0.25)
    assert error_m[doubtful].mean() > 1.15 * error_m[certain].mean()


def test_every_position_has_uncertainty_and_nothing_else() -> None:
    for track in animated("noisy").tracks:
        assert track.uncertainty_m is not None
        np.testing.assert_array_equal(np.isfinite(track.uncertainty_m), np.isfinite(track.xyz_m[..., 0]))
        predicted, measured = track.source == Source.PREDICTED, track.source == Source.MEASURED
        if predicted.sum() > 20:
            assert np.median(track.uncertainty_m[predicted]) > 1.2 * np.median(track.uncertainty_m[measured])


@pytest.mark.parametrize("smoothing", slow_but(["butterworth"], ["none", "butterworth", "one-euro"]))
def test_other_smoothing_states_none(smoothing: Smoothing) -> None:
    assert all(track.uncertainty_m is None for track in animated("room", smoothing=smoothing).tracks)


@pytest.mark.slow
def test_windows_leave_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation, found = taken("room")
    whole = animated("room")
    monkeypatch.setattr(time_series, "_WINDOW_FRAMES", 100)
    cut = animate(*found, simulation.cameras, simulation.timebase, simulation.joints, ReconstructionConfig())
    for one, other in zip(whole.tracks, cut.tracks, strict=True):
        assert one.uncertainty_m is not None
        assert other.uncertainty_m is not None
        ratio = other.uncertainty_m / one.uncertainty_m
        assert 0.8 < np.nanquantile(ratio, 0.01) < np.nanquantile(ratio, 0.99) < 1.25


def t_pose(num_frames: int) -> tuple[JointPoses, Articulation]:
    lengths_m = np.array([1.7 * joint.stature_share for joint in SKELETON])
    skeleton = articulate(lengths_m, COCO_17, {name: np.array([0.02, -0.08, 0.01]) for name in COCO_17.names[:5]})
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (num_frames, len(SKELETON), 1))
    return start_from(np.zeros((num_frames, 3)), quat, skeleton), skeleton


class Even:
    """Evidence of the same precision for all landmarks."""

    def __init__(self, per_m2: np.ndarray) -> None:
        self._per_m2 = per_m2

    def precision(self, landmark_m: np.ndarray) -> np.ndarray:
        return np.asarray(self._per_m2[:, None, None, None] * np.broadcast_to(np.eye(3), (*landmark_m.shape, 3)))


def test_one_frame_has_covariance_of_its_normal_equations() -> None:
    bodies, skeleton = t_pose(1)
    jacobian = Posed(bodies, skeleton).jacobian()[0]
    moving = np.zeros((len(skeleton.landmark), 3, skeleton.num_freedoms))
    for landmark, count in enumerate(skeleton.num_moved_by):
        moving[landmark][:, skeleton.moved_by[landmark, :count]] = jacobian[landmark, :count].T
    curvature = np.diag(_priors(skeleton)) + 1e4 * np.einsum("lai,laj->ij", moving, moving)
    variance_m2 = np.einsum("lai,ij,laj->l", moving, np.linalg.inv(curvature), moving) / 3
    expected_m = np.sqrt(SIMULATED_LASTING**2 * variance_m2 + _FLOOR_M**2)
    found_m = uncertainty_m(bodies, skeleton, Even(np.array([1e4])), RATE_HZ)
    np.testing.assert_allclose(found_m[0], expected_m, rtol=1e-9)
    assert (_priors(skeleton) >= _INERTIA).all()


def test_uncertainty_grows_where_evidence_ends() -> None:
    bodies, skeleton = t_pose(60)
    per_m2 = np.where(np.arange(60) < 40, 1e4, 1e2)
    found_m = uncertainty_m(bodies, skeleton, Even(per_m2), RATE_HZ).mean(1)
    assert found_m[20] < 0.02
    assert found_m[50] > 4 * found_m[20]
    assert (np.diff(found_m[30:50]) > -1e-12).all()
    # Neighbours in time help: a frame by itself is less certain.
    alone, _ = t_pose(1)
    assert uncertainty_m(alone, skeleton, Even(np.array([1e4])), RATE_HZ).mean() > 1.2 * found_m[20]


def test_disagreement_is_weight_of_views_that_show_another_place() -> None:
    cameras = taken("room", 4, 2.0)[0].cameras
    place_m, elsewhere_m = np.array([[[0.1, 0.2, 1.0]]]), np.array([[[0.1, 1.2, 2.0]]])
    shown_m = [place_m, place_m, elsewhere_m, place_m]
    points_px = np.stack([project(camera, xyz_m[0]) for camera, xyz_m in zip(cameras, shown_m, strict=True)])[None]
    points_px = np.repeat(points_px, len(COCO_17.names), axis=2)
    score = np.full(points_px.shape[:3], 0.8)
    score[:, 3] = 0.0  # a view that sees nothing does not disagree
    evidence = LandmarkEvidence(
        Rays(cameras, points_px, score, COCO_17), np.array([0, 5]), np.zeros((1, 2, 3)), np.zeros((1, 2, 3))
    )
    at_m = np.concatenate([place_m, elsewhere_m], axis=1)
    np.testing.assert_allclose(evidence.disagreement(at_m), [[1 / 3, 2 / 3]], atol=0.02)
    assert not replace(evidence, rays=None).disagreement(at_m).any()
    stated_m = disagreement_m(np.array([[0.0, 0.1, 1.0]]))
    np.testing.assert_allclose(stated_m, [[0.0, 0.2 * 0.1**1.5, 0.2]])


def test_networks_with_offsets_state_their_lasting_errors() -> None:
    simulation, (tracks, seen) = taken("room", 4, 2.0)
    cameras, timebase, joints = simulation.cameras, simulation.timebase, simulation.joints
    ratios = []
    for offsets in (MARKED_AT_CENTERS, {"hip": JointOffset(up=1e-9)}):
        found = animate(tracks, seen, cameras, timebase, joints, ReconstructionConfig(), offsets=offsets)
        stated_m = found.tracks[0].uncertainty_m
        assert stated_m is not None
        ratios.append(np.nanmedian(stated_m))
    assert ratios[1] / ratios[0] == pytest.approx(NETWORK_LASTING / SIMULATED_LASTING, rel=0.1)
