"""Resampling of motion to another rate."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.resample import _rotations_at, resample
from pipeline.export.results import write_results
from pipeline.motion.skeleton.model import forward_kinematics
from pipeline.run.engine.local import reconstruct
from tests.pipeline.export.writers.test_bvh import with_fingers
from tests.pipeline.test_restrict import session

__all__ = ["session"]


@pytest.fixture(scope="module")
def take(session: KeypointSession) -> Reconstruction:
    return reconstruct(session, ReconstructionConfig())


@pytest.mark.slow
def test_session_s_own_rate_changes_nothing(take: Reconstruction) -> None:
    same = resample(take, take.timebase.frame_rate_hz)
    assert asdict(same.timebase) == asdict(take.timebase)
    for one, other in zip(take.tracks, same.tracks, strict=True):
        np.testing.assert_array_equal(one.xyz_m, other.xyz_m)
        np.testing.assert_array_equal(one.source, other.source)
    for mine, theirs in zip(take.motions, same.motions, strict=True):
        np.testing.assert_allclose(mine.parent_from_joint, theirs.parent_from_joint, atol=1e-12)
        assert mine.contacts == theirs.contacts


@pytest.mark.parametrize("factor", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_resampling_by_multiple_keeps_frames_of_session(take: Reconstruction, factor: int) -> None:
    fine = resample(take, factor * take.timebase.frame_rate_hz)
    assert fine.timebase.num_frames == factor * (take.timebase.num_frames - 1) + 1
    for one, other in zip(take.tracks, fine.tracks, strict=True):
        assert other.start_frame == factor * one.start_frame
        np.testing.assert_allclose(other.xyz_m[::factor], one.xyz_m, atol=1e-12)
        assert one.uncertainty_m is not None
        assert other.uncertainty_m is not None
        np.testing.assert_array_equal(other.uncertainty_m[::factor], one.uncertainty_m)
        np.testing.assert_array_equal(np.isfinite(other.uncertainty_m), np.isfinite(other.xyz_m[..., 0]))
    for mine, theirs in zip(take.motions, fine.motions, strict=True):
        np.testing.assert_allclose(forward_kinematics(theirs)[::factor], forward_kinematics(mine), atol=1e-9)
        assert theirs.frame_rate_hz == factor * mine.frame_rate_hz


@pytest.mark.parametrize("rate_hz", [5.0, 23.976, 24.0, 29.97, 60.0, 120.0])
def test_everybody_is_where_they_are_between_two_frames(take: Reconstruction, rate_hz: float) -> None:
    other = resample(take, rate_hz)
    old, new = take.timebase, other.timebase
    assert (new.start_time_s, new.frame_rate_hz) == (old.start_time_s, rate_hz)
    assert new.time_s(new.num_frames - 1) <= old.time_s(old.num_frames - 1) + 1e-6
    assert new.time_s(new.num_frames) > old.time_s(old.num_frames - 1)
    assert len(other.tracks) == len(take.tracks)
    for track, mine in zip(take.tracks, other.tracks, strict=True):
        for frame in range(mine.num_frames):
            place = (mine.start_frame + frame) / rate_hz * old.frame_rate_hz - track.start_frame
            before, behind = (
                track.xyz_m[int(np.clip(round_(place), 0, track.num_frames - 1))] for round_ in (np.floor, np.ceil)
            )
            low, high = np.minimum(before, behind) - 1e-6, np.maximum(before, behind) + 1e-6
            found = mine.xyz_m[frame]
            known = np.isfinite(found).all(-1)
            assert ((found[known] >= low[known]) & (found[known] <= high[known])).all()
            assert (mine.source[frame][~known] == 0).all()
            assert (mine.source[frame][known] > 0).all()
    for motion, track in zip(other.motions, other.tracks, strict=True):
        assert (motion.start_frame, len(motion.root_m)) == (track.start_frame, track.num_frames)
        np.testing.assert_allclose(np.linalg.norm(motion.parent_from_joint, axis=-1), 1.0, atol=1e-9)
        assert all(0 <= one.start_frame <= len(motion.root_m) for one in motion.contacts)


def test_person_between_two_frames_is_left_out(take: Reconstruction) -> None:
    short = replace(take.tracks[0], start_frame=1, **{
        name: getattr(take.tracks[0], name)[:2]
        for name in ("xyz_m", "score", "source", "error_px", "views", "uncertainty_m")
    })  # fmt: skip
    motion = take.motions[0]
    motion = replace(
        motion, start_frame=1, root_m=motion.root_m[:2], parent_from_joint=motion.parent_from_joint[:2], contacts=()
    )
    animation = replace(take.animation, tracks=(short, *take.tracks[1:]), motions=(motion, *take.motions[1:]))
    assert len(resample(replace(take, animation=animation), 1.0).tracks) == len(take.tracks) - 1


@given(seed=st.integers(0, 1000), weight=st.floats(0.0, 1.0))
def test_between_two_rotations_it_turns_along_shorter_arc(seed: int, weight: float) -> None:
    before, after = Rotation.random(2, rng=np.random.default_rng(seed))
    quat_xyzw = np.stack([before.as_quat(), -after.as_quat()])[:, None]
    found_xyzw = _rotations_at(quat_xyzw, np.array([0.0, weight, 1.0]))
    found = Rotation.from_quat(found_xyzw[1, 0])
    angle = (before.inv() * after).magnitude()
    assert (before.inv() * found).magnitude() == pytest.approx(weight * angle, abs=1e-7)
    assert (found.inv() * after).magnitude() == pytest.approx((1 - weight) * angle, abs=1e-7)
    np.testing.assert_allclose(found_xyzw[0], quat_xyzw[0], atol=1e-12)


def test_quaternions_that_are_continuous_stay_so(take: Reconstruction) -> None:
    for motion in resample(take, 2.5 * take.timebase.frame_rate_hz).motions:
        quat = motion.parent_from_joint
        assert ((quat[1:] * quat[:-1]).sum(-1) > 0).all()


def test_fingers_are_resampled_with_body(take: Reconstruction) -> None:
    motions = tuple(with_fingers(motion) for motion in take.motions)
    whole = replace(take, animation=replace(take.animation, motions=motions))
    rate_hz = 2 * take.timebase.frame_rate_hz
    for motion, body, old in zip(
        resample(whole, rate_hz).motions, resample(take, rate_hz).motions, motions, strict=True
    ):
        np.testing.assert_array_equal(motion.parent_from_joint[:, :24], body.parent_from_joint)
        assert motion.parent_from_joint.shape[1] == 64
        np.testing.assert_allclose(forward_kinematics(motion)[::2], forward_kinematics(old), atol=1e-9)


def test_single_frame_keeps_its_rotations() -> None:
    quat_xyzw = Rotation.random(4, rng=np.random.default_rng(0)).as_quat()[None]
    np.testing.assert_array_equal(_rotations_at(quat_xyzw, np.zeros(1)), quat_xyzw)


def test_all_formats_hold_it(take: Reconstruction, tmp_path: Path) -> None:
    # Each file is read back and compared as it is written. One of the people walks, with two tables of the steps; each
    # has one of balance.
    assert len(write_results(take, tmp_path, ("bvh", "glb", "trc", "c3d", "csv"), frame_rate_hz=48.0)) == 23
