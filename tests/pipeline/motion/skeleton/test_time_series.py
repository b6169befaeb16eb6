"""Gaps, windows and smoothing of positions over time."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.joints import JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.time_series import (
    Blend,
    butterworth,
    filled_linearly,
    filled_relative_to,
    one_euro,
    smooth_track,
    windows,
)
from pipeline.validation.evaluation.simulated import score_simulated
from pipeline.validation.simulation.scenes import find_scene, record

NAN = np.full(3, np.nan)


def test_linear_inside_and_held_at_ends() -> None:
    points = np.array([NAN, [0.0, 1.0, 2.0], NAN, NAN, [3.0, 1.0, -1.0], NAN])
    expected = [[0, 1, 2], [0, 1, 2], [1, 1, 1], [2, 1, 0], [3, 1, -1], [3, 1, -1]]
    np.testing.assert_allclose(filled_linearly(points, np.zeros(3)), expected)


def test_default_where_nothing_is_known() -> None:
    np.testing.assert_allclose(filled_linearly(np.array([NAN, NAN]), np.array([1.0, 2.0, 3.0])), [[1, 2, 3]] * 2)


def test_carried_point_keeps_its_offset() -> None:
    reference = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 7.0, 0.0]])
    points = np.array([[0.0, 0.0, 1.0], NAN, [0.0, 7.0, 2.0]])
    np.testing.assert_allclose(
        filled_relative_to(points, reference, np.zeros(3)), np.array([[0, 0, 1], [5, 0, 1.5], [0, 7, 2]])
    )
    np.testing.assert_allclose(filled_relative_to(np.array([NAN] * 3), reference, np.ones(3)), reference + 1)


@pytest.mark.parametrize("num_frames", [1, 60, 599, 600, 601, 660, 1140, 1141, 5000])
def test_windows_cover_all_frames_and_overlap(num_frames: int) -> None:
    rows = list(windows(num_frames))
    assert rows[0].start == 0
    assert rows[-1].stop == num_frames
    for before, after in pairwise(rows):
        assert before.stop - after.start == 60
    assert max(one.stop - one.start for one in rows) <= 600


def test_equal_windows_blend_to_same() -> None:
    values = np.random.default_rng(0).normal(size=(1500, 4, 3))
    result = np.empty((1500, 4, 3))
    blend = Blend(result)
    for rows in windows(1500):
        blend.add(rows, values[rows])
    np.testing.assert_allclose(result, values)


def test_windows_that_differ_pass_evenly_into_each_other() -> None:
    result = np.empty((1100, 1))
    blend = Blend(result)
    for number, rows in enumerate(windows(1100)):
        blend.add(rows, np.full((rows.stop - rows.start, 1), float(number)))
    steps = np.diff(result[:, 0])
    assert steps.min() >= 0.0
    assert steps.max() < 0.02


def test_window_fills_unknowns_of_other_window() -> None:
    result = np.empty((1100, 1))
    blend = Blend(result)
    first, second = windows(1100)
    blend.add(first, np.full((600, 1), np.nan))
    blend.add(second, np.ones((second.stop - second.start, 1)))
    assert np.isnan(result[:540]).all()
    assert (result[540:] == 1.0).all()


BUTTERWORTH = ReconstructionConfig(smoothing="butterworth")
TWO_JOINTS = JointSet(("one", "other"), ())
ONE_EURO = ReconstructionConfig(smoothing="one-euro")


def wave(rate_hz: float, frequency_hz: float, duration_s: float = 8.0) -> np.ndarray:
    """Track of a joint that swings along X by a metre."""
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    return np.sin(2 * np.pi * frequency_hz * time_s)[:, None, None] * np.array([1.0, 0.0, 0.0])


def gain(rate_hz: float, frequency_hz: float) -> float:
    """Gain of a Butterworth low-pass filter of 6 Hz without phase shift, away from the ends."""
    before, after = wave(rate_hz, frequency_hz)[..., 0], butterworth(wave(rate_hz, frequency_hz), rate_hz, 6.0)[..., 0]
    middle = slice(len(before) // 4, -len(before) // 4)
    return float((before[middle] * after[middle]).sum() / (before[middle] ** 2).sum())


@pytest.mark.parametrize("rate_hz", [25.0, 59.94, 119.88])
def test_cutoff_is_in_hertz_and_that_of_both_passes(rate_hz: float) -> None:
    assert gain(rate_hz, 1.0) == pytest.approx(1.0, abs=0.01)
    assert gain(rate_hz, 6.0) == pytest.approx(np.sqrt(0.5), abs=0.01)
    if rate_hz > 50:
        assert gain(rate_hz, 20.0) < 0.02


def test_nothing_is_delayed() -> None:
    slow = wave(50.0, 1.5)
    np.testing.assert_allclose(butterworth(slow, 50.0, 6.0)[50:-50], slow[50:-50], atol=0.02)


@pytest.mark.parametrize("config", [BUTTERWORTH, ONE_EURO])
def test_gaps_part_and_stay(ring: tuple[Camera, ...], config: ReconstructionConfig) -> None:
    xyz_m = np.random.default_rng(2).normal(size=(60, 2, 3)) * 0.01
    xyz_m[30:, 0] += 5.0  # somewhere else after the gap
    xyz_m[20:30, 0] = np.nan
    xyz_m[50, 0] = np.nan
    xyz_m[52, 0] = np.nan  # a single known frame between two gaps
    smoothed = smooth_track(track_of(xyz_m), unseen(60, 2), ring, Timebase(0.0, 25.0, 60), config)
    np.testing.assert_array_equal(np.isnan(smoothed.xyz_m), np.isnan(xyz_m))
    assert np.abs(smoothed.xyz_m[:20, 0]).max() < 0.05
    assert np.abs(smoothed.xyz_m[30:, 0] - 5.0)[np.isfinite(xyz_m[30:, 0])].max() < 0.05
    np.testing.assert_array_equal(smoothed.xyz_m[51, 0], xyz_m[51, 0])
    assert np.nanstd(np.diff(smoothed.xyz_m[:, 1], axis=0)) < 0.7 * np.nanstd(np.diff(xyz_m[:, 1], axis=0))


@pytest.mark.parametrize("num_frames", [1, 2, 3, 7])
@pytest.mark.parametrize("config", [BUTTERWORTH, ONE_EURO])
def test_short_tracks_and_what_stands_still(
    ring: tuple[Camera, ...], num_frames: int, config: ReconstructionConfig
) -> None:
    still = np.tile([[1.0, 2.0, 3.0]], (num_frames, 2, 1))
    timebase = Timebase(0.0, 25.0, num_frames)
    smoothed = smooth_track(track_of(still), unseen(num_frames, 2), ring, timebase, config)
    np.testing.assert_allclose(smoothed.xyz_m, still, atol=1e-9)


def test_one_euro_of_fast_hand_lags_less_than_slow_filter() -> None:
    fast = wave(50.0, 1.5)
    lag = np.abs(one_euro(fast, 50.0) - fast)[50:, :, 0].max()
    assert lag < 0.25  # at up to 9.4 m/s; the cutoff of a joint at rest alone lags 0.45 m


@pytest.mark.parametrize("config", [BUTTERWORTH, ONE_EURO])
def test_simulated_people_tremble_less_and_are_where_they_were(config: ReconstructionConfig) -> None:
    simulation = record(replace(find_scene("room"), duration_s=4.0), seed=3)
    rate_hz = simulation.timebase.frame_rate_hz
    found = reconstruct_tracks(
        simulation.cameras,
        simulation.times,
        simulation.detections,
        simulation.timebase,
        derive_parameters(simulation.cameras, rate_hz),
    )
    smoothed = tuple(
        smooth_track(track, seen, simulation.cameras, simulation.timebase, config)
        for track, seen in zip(*found, strict=True)
    )
    before, after = (score_simulated(tracks, simulation, simulation.joints) for tracks in (found[0], smoothed))
    assert after["jitter_m_s2"] < 0.7 * before["jitter_m_s2"]
    assert after["mpjpe_mm"] < 1.1 * before["mpjpe_mm"]
    assert after["switches"] == before["switches"]


def test_reprojection_error_is_that_of_final_positions(ring: tuple[Camera, ...]) -> None:
    rng = np.random.default_rng(5)
    true_m = np.tile([[0.2, 0.1, 1.0]], (40, 1, 1))
    seen_px = np.stack([project(camera, true_m) for camera in ring], axis=1)
    seen = Observations(1, seen_px, np.ones(seen_px.shape[:3]))
    noisy = track_of(true_m + 0.02 * rng.normal(size=true_m.shape))
    smoothed = smooth_track(noisy, seen, ring, Timebase(0.0, 25.0, 40), replace(BUTTERWORTH, cutoff_hz=1.0))
    errors_px = np.linalg.norm(np.stack([project(c, smoothed.xyz_m) for c in ring], axis=1) - seen_px, axis=-1).mean(1)
    np.testing.assert_allclose(smoothed.error_px, errors_px, rtol=1e-6)


def test_none_gives_same_tracks() -> None:
    track = track_of(np.zeros((3, 1, 3)))
    assert (
        smooth_track(track, unseen(3, 1), [], Timebase(0.0, 25.0, 3), ReconstructionConfig(smoothing="none")) is track
    )


def track_of(xyz_m: np.ndarray) -> Track3D:
    shape = xyz_m.shape[:2]
    return Track3D(1, 0, xyz_m, np.ones(shape), np.ones(shape, np.int8), np.zeros(shape), np.full(shape, 2))


def unseen(num_frames: int, num_joints: int) -> Observations:
    shape = num_frames, 4, num_joints
    return Observations(1, np.full((*shape, 2), np.nan), np.zeros(shape))
