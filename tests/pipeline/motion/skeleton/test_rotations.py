import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.rotations import (
    align,
    continuous_quat_xyzw,
    filled,
    from_axes,
    hinge_twist_rad,
    swing,
    unit,
)

X, Y, Z = np.eye(3)
vectors = arrays(float, (5, 3), elements=st.floats(-2, 2, width=32))


def angle_deg(a: Rotation, b: Rotation) -> np.ndarray:
    return np.degrees((a.inv() * b).magnitude())


@given(vectors)
def test_swing_reaches_its_target_without_twist(end: np.ndarray) -> None:
    assume((np.linalg.norm(end, axis=-1) > 1e-3).all())
    turned, valid = swing(Z, end)
    assert valid.all()
    # As close to a half turn as this it is taken for one.
    np.testing.assert_allclose(turned.apply(Z), unit(end), atol=1e-6)
    # The axis of the smallest rotation is at right angles to the start.
    np.testing.assert_allclose(turned.as_rotvec() @ Z, 0.0, atol=1e-6)


def test_swing_knows_half_turns_and_unknown_targets() -> None:
    turned, valid = swing(X, np.array([[-2.0, 0.0, 0.0], [np.nan, 1.0, 0.0], [0.0, 0.0, 0.0]]))
    assert valid.tolist() == [True, False, False]
    np.testing.assert_allclose(turned[0].apply(X), -X, atol=1e-12)
    np.testing.assert_allclose(turned[1:].as_quat(), [[0, 0, 0, 1]] * 2)


def test_axes_keep_left_exact_and_up_close() -> None:
    left = np.array([[0.0, 2.0, 0.2], [0.0, 0.0, 1.0], [np.nan, 0.0, 0.0]])
    rotation, valid = from_axes(left, np.tile(Z, (3, 1)))
    assert valid.tolist() == [True, False, False]
    np.testing.assert_allclose(rotation[0].apply(X), unit(left[0]))
    np.testing.assert_allclose(rotation[0].apply(Z), unit(np.array([0.0, -0.2, 2.0])))
    # Left to +Y means facing +X, and faces look along -Y at rest.
    assert rotation[0].apply(-Y) @ X > 0.99


@given(st.integers(0, 2**32 - 1))
def test_align_finds_rotation_behind_noisy_vectors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = rng.normal(size=(3, 6, 3))
    truth = Rotation.random(3, rng=rng)
    end = np.stack([truth[frame].apply(start[frame]) for frame in range(3)])
    end[:, 4] = np.nan
    np.testing.assert_allclose(angle_deg(align(start, end), truth), 0.0, atol=1e-4)
    # Mirrored vectors still give a proper rotation.
    np.testing.assert_allclose(np.linalg.det(align(start, -end).as_matrix()), 1.0)


def test_filled_interpolates_inside_and_holds_at_ends() -> None:
    about_y = Rotation.from_euler("Y", [[0], [20], [0], [0], [80], [0]], degrees=True)
    result = filled(about_y, np.array([False, True, False, False, True, False]))
    np.testing.assert_allclose(result.as_euler("YXZ", degrees=True)[:, 0], [20, 20, 40, 60, 80, 80])


def test_filled_knows_one_frame_and_none() -> None:
    about_y = Rotation.from_euler("Y", [[10], [20], [30]], degrees=True)
    once = filled(about_y, np.array([False, True, False]))
    np.testing.assert_allclose(once.magnitude(), np.radians(20))
    np.testing.assert_allclose(filled(about_y, np.zeros(3, dtype=bool)).magnitude(), 0.0)


def test_quaternions_stay_on_one_hemisphere_over_two_full_turns() -> None:
    quat = continuous_quat_xyzw(Rotation.from_euler("Z", np.linspace(0, 720, 73)[:, None], degrees=True))
    assert (np.linalg.norm(np.diff(quat, axis=0), axis=-1) < np.radians(10) / 2 + 1e-3).all()
    assert quat[0, 3] == 1.0
    np.testing.assert_allclose(quat[36], [0, 0, 0, -1], atol=1e-12)


def lower_limb(twist_rad: np.ndarray, bend_rad: np.ndarray) -> np.ndarray:
    """Rotation of a left forearm along X with hinge -Z, twisted about X and bent."""
    before_twist = Rotation.from_rotvec(bend_rad[:, None] * -Z).apply(X)
    return Rotation.from_rotvec(twist_rad[:, None] * X).apply(before_twist)


@pytest.mark.parametrize("twist_deg", [-80.0, 0.0, 30.0, 90.0])
def test_twist_of_bent_limb_is_found(twist_deg: float) -> None:
    truth = np.full(20, np.radians(twist_deg))
    twist = hinge_twist_rad(X, -Z, lower_limb(truth, np.full(20, 1.2)), 30.0)
    np.testing.assert_allclose(np.degrees(twist), twist_deg, atol=3.0)


def test_twist_passes_evenly_through_straight_stretch() -> None:
    frames = np.arange(60)
    truth = np.radians(60.0) * frames / 59
    bend = np.where((frames > 20) & (frames < 40), 0.0, 1.3)
    lower = lower_limb(truth, bend) + np.random.default_rng(3).normal(scale=0.04, size=(60, 3))
    twist = hinge_twist_rad(X, -Z, lower, 30.0)
    np.testing.assert_allclose(np.degrees(twist), np.degrees(truth), atol=15.0)
    assert np.abs(np.degrees(np.diff(twist))).max() < 8.0


def test_twist_is_natural_where_nothing_is_known() -> None:
    np.testing.assert_allclose(hinge_twist_rad(X, -Z, np.full((1, 3), np.nan), 30.0), 0.0)
    straight_with_noise = np.tile(X, (40, 1)) + np.random.default_rng(1).normal(scale=0.05, size=(40, 3))
    twist = hinge_twist_rad(X, -Z, straight_with_noise, 30.0)
    assert np.abs(np.degrees(twist)).max() < 30.0
