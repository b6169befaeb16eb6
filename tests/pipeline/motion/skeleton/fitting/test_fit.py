"""Fit of whole tracks of simulated people, compared with the exact truth."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.geometry.camera import project
from pipeline.motion.skeleton import time_series
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.fitting import rays
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, match_frames, select_joints
from pipeline.validation.evaluation.simulated import score_simulated
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from pipeline.validation.simulation.views.detector import PERFECT, DetectorAccuracy
from pipeline.validation.simulation.views.faults import Faults

HARD = DetectorAccuracy(noise_m=0.0, noise_px=3.0, faults=Faults(miss_joint=0.2, swap=0.05))
KNEE = COCO_17.index("left_knee")
_Found = tuple[tuple[Track3D, ...], tuple[Observations, ...]]


def track_people(simulation: Simulation) -> _Found:
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    return reconstruct_tracks(
        simulation.cameras, simulation.times, simulation.detections, simulation.timebase, parameters
    )


def fitted(simulation: Simulation, found: _Found) -> tuple[Track3D, ...]:
    return animate(*found, simulation.cameras, simulation.timebase, simulation.joints, ReconstructionConfig()).tracks


def fit_one(track: Track3D, seen: Observations, cameras: tuple[Camera, ...]) -> Track3D:
    timebase = Timebase(0.0, 25.0, track.num_frames)
    (found,) = animate([track], [seen], cameras, timebase, COCO_17, ReconstructionConfig()).tracks
    return found


def errors_m(tracks: tuple[Track3D, ...], simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the found joints among the twelve, and their true speeds in m/s."""
    truth_m = simulation.truth_m[:, :, COCO_17.indices(BODY_JOINTS)]
    predicted_m = select_joints(tracks, COCO_17, BODY_JOINTS, np.arange(truth_m.shape[1]))
    matched = match_frames(predicted_m, truth_m)
    of_match_m = predicted_m[matched, np.arange(truth_m.shape[1])]
    error_m = np.where((matched >= 0)[..., None], np.linalg.norm(of_match_m - truth_m, axis=-1), np.nan)
    speed_m_s = np.linalg.norm(np.gradient(truth_m, axis=1), axis=-1) * simulation.timebase.frame_rate_hz
    known = np.isfinite(error_m)
    return error_m[known], speed_m_s[known]


@pytest.mark.parametrize("scene", ["room", pytest.param("outdoor", marks=pytest.mark.slow)])
def test_fit_of_fast_motion_removes_noise_misses_and_swaps(scene: str) -> None:
    simulation = record(replace(find_scene(scene), duration_s=6.0, detector=HARD), seed=5)
    found = track_people(simulation)
    (raw_m, raw_speed), (fit_m, fit_speed) = (
        errors_m(tracks, simulation) for tracks in (found[0], fitted(simulation, found))
    )
    assert fit_m.mean() <= 0.75 * raw_m.mean()
    fast_raw, fast_fit = raw_speed >= np.quantile(raw_speed, 0.9), fit_speed >= np.quantile(fit_speed, 0.9)
    assert fit_m[fast_fit].mean() <= 0.75 * raw_m[fast_raw].mean()


@pytest.mark.slow
def test_people_tremble_less_and_their_bones_keep_their_length() -> None:
    simulation = record(replace(find_scene("noisy"), duration_s=4.0), seed=7)
    found = track_people(simulation)
    before, after = (score_simulated(tracks, simulation, COCO_17) for tracks in (found[0], fitted(simulation, found)))
    assert after["jitter_m_s2"] <= before["jitter_m_s2"] / 2.5
    assert after["bone_std_cm"] <= 0.5
    assert after["people_correct"] == before["people_correct"]
    assert after["recall"] == before["recall"]


def test_exact_points_stay_in_place() -> None:
    """Punches, jumps and swings included."""
    simulation = record(replace(find_scene("room"), duration_s=6.0, detector=PERFECT), seed=4)
    error_m, _ = errors_m(fitted(simulation, track_people(simulation)), simulation)
    assert error_m.mean() <= 0.003
    assert np.quantile(error_m, 0.99) <= 0.02


def one_knee(ring: tuple[Camera, ...], num_frames: int) -> tuple[Track3D, Observations, np.ndarray]:
    """Track of a left knee that swings slowly, with exact observations of four cameras; other joints are absent."""
    time_s = np.arange(num_frames) / 25.0
    true_m = np.stack([0.3 * np.sin(2 * time_s), 0.1 * np.cos(time_s), 0.5 + 0.05 * np.sin(time_s)], axis=-1)
    xyz_m = np.full((num_frames, 17, 3), np.nan)
    xyz_m[:, KNEE] = true_m
    points_px = np.full((num_frames, len(ring), 17, 2), np.nan)
    points_px[:, :, KNEE] = np.stack([project(camera, true_m) for camera in ring], axis=1)
    score = np.where(np.isfinite(points_px[..., 0]), 0.9, 0.0)
    source = np.where(np.isfinite(xyz_m[..., 0]), Source.MEASURED, Source.ABSENT).astype(np.int8)
    views = np.isfinite(points_px[..., 0]).sum(1)
    track = Track3D(1, 0, xyz_m, score.max(1), source, np.full(source.shape, np.nan), views)
    return track, Observations(1, points_px, score), true_m


def test_wrong_view_does_not_pull(ring: tuple[Camera, ...]) -> None:
    track, seen, true_m = one_knee(ring, 50)
    points_px = np.array(seen.points_px)
    points_px[:, 2, KNEE] += 60.0
    found = fit_one(track, replace(seen, points_px=points_px), ring)
    assert np.linalg.norm(found.xyz_m[:, KNEE] - true_m, axis=-1).max() < 0.01
    assert np.isnan(np.delete(found.xyz_m, KNEE, axis=1)).all()  # what was never located stays unknown


def test_gap_is_predicted_and_marked_and_long_one_stays_open(ring: tuple[Camera, ...]) -> None:
    track, seen, true_m = one_knee(ring, 120)
    xyz_m, source, points_px, score = (np.array(a) for a in (track.xyz_m, track.source, seen.points_px, seen.score))
    for gap in (slice(20, 30), slice(60, 100)):
        xyz_m[gap], source[gap], points_px[gap], score[gap] = np.nan, Source.ABSENT, np.nan, 0.0
    points_px[40:50, 1:], score[40:50, 1:] = np.nan, 0.0  # one view is left
    xyz_m[40:50], source[40:50] = np.nan, Source.ABSENT
    track, seen = replace(track, xyz_m=xyz_m, source=source), Observations(1, points_px, score)
    found = fit_one(track, seen, ring)
    knee = found.source[:, KNEE]
    assert (knee[20:30] == Source.PREDICTED).all()
    assert (knee[40:50] == Source.PREDICTED).all()
    assert (knee[60:100] == Source.ABSENT).all()
    assert (knee[30:40] == Source.MEASURED).all()
    np.testing.assert_array_equal(np.isnan(found.xyz_m[:, KNEE, 0]), knee == Source.ABSENT)
    assert np.linalg.norm(found.xyz_m[20:50, KNEE] - true_m[20:50], axis=-1).max() < 0.03


def test_windows_leave_no_trace(ring: tuple[Camera, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    track, seen, _ = one_knee(ring, 500)
    seen = replace(seen, points_px=seen.points_px + rng.normal(0.0, 2.0, seen.points_px.shape))
    whole = fit_one(track, seen, ring)
    monkeypatch.setattr(time_series, "_WINDOW_FRAMES", 160)
    cut = fit_one(track, seen, ring)
    assert np.nanmax(np.linalg.norm(cut.xyz_m - whole.xyz_m, axis=-1)) < 1e-3


@pytest.mark.parametrize("num_frames", [1, 2, 3, 61])
def test_short_tracks(ring: tuple[Camera, ...], num_frames: int) -> None:
    track, seen, true_m = one_knee(ring, num_frames)
    found = fit_one(track, seen, ring)
    np.testing.assert_allclose(found.xyz_m[:, KNEE], true_m, atol=2e-3)
    np.testing.assert_allclose(found.error_px[:, KNEE], 0.0, atol=1.0)


def test_view_that_takes_left_for_right_is_put_right(ring: tuple[Camera, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """With two cameras no majority outvotes the wrong camera."""
    simulation = record(replace(find_scene("room"), duration_s=2.0, detector=PERFECT), seed=6)
    true_m, cameras = simulation.truth_m[0], ring[:2]
    points_px = np.stack([project(camera, true_m) for camera in cameras], axis=1)
    seen_px = points_px.copy()
    names = ("hip", "knee", "ankle")
    left, right = (COCO_17.indices(tuple(f"{side}_{name}" for name in names)) for side in ("left", "right"))
    wrong = slice(15, 30)
    seen_px[wrong, 1, left], seen_px[wrong, 1, right] = points_px[wrong, 1][:, right], points_px[wrong, 1][:, left]
    shape = true_m.shape[:2]
    track = Track3D(
        1, 0, true_m, np.ones(shape), np.full(shape, Source.MEASURED, np.int8), np.zeros(shape), np.full(shape, 2)
    )
    seen = Observations(1, seen_px, np.full(seen_px.shape[:3], 0.9))

    def leg_error_m() -> float:
        found = fit_one(track, seen, cameras)
        legs = [*left, *right]
        return float(np.linalg.norm(found.xyz_m[wrong][:, legs] - true_m[wrong][:, legs], axis=-1).mean())

    assert leg_error_m() < 0.005
    monkeypatch.setattr(rays.Rays, "exchange_sides", lambda *_: None)
    assert leg_error_m() > 0.01
