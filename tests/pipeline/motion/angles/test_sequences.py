"""Sequences of rotations: angles make the rotation again, and are continuous in time."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.motion.angles.definitions import JOINTS, Sequence
from pipeline.motion.angles.sequences import angles_rad, continuous, is_locked, mirrored

SEQUENCES: list[Sequence] = sorted({joint.sequence for joint in JOINTS} | {(0, 1, 2), (2, 1, 0), (2, 1, 2), (0, 2, 0)})


def name_of(sequence: Sequence) -> str:
    return "".join("XYZ"[axis] for axis in sequence)


@pytest.mark.parametrize("sequence", SEQUENCES, ids=name_of)
def test_angles_make_the_rotation_again(sequence: Sequence) -> None:
    rotation = Rotation.random(500, np.random.default_rng(3)).as_matrix()
    found_rad = angles_rad(rotation, sequence)
    np.testing.assert_allclose(Rotation.from_euler(name_of(sequence), found_rad).as_matrix(), rotation, atol=1e-9)
    is_proper = sequence[0] == sequence[2]
    low_deg, high_deg = (-180.0, 0.0) if is_proper else (-90.0, 90.0)
    assert (np.degrees(found_rad[:, 1]) >= low_deg).all()
    assert (np.degrees(found_rad[:, 1]) <= high_deg).all()


def test_the_mirror_keeps_rotations_about_the_axis_to_the_right() -> None:
    turned = Rotation.from_euler("ZXY", [[0.3, 0.2, -0.4]]).as_matrix()
    np.testing.assert_allclose(angles_rad(mirrored(turned), (2, 0, 1)), [[0.3, -0.2, 0.4]], atol=1e-12)


def test_an_arm_that_is_raised_aside_and_overhead_is_abducted_by_more_than_90_degrees() -> None:
    raised_deg = np.linspace(0.0, 170.0, 60)
    rotation = Rotation.from_euler("ZXY", np.stack([0 * raised_deg + 2.0, -raised_deg, 0 * raised_deg], -1), True)
    found_deg = np.degrees(continuous(angles_rad(rotation.as_matrix(), (2, 0, 1)), is_proper=False))
    np.testing.assert_allclose(found_deg[:, 1], -raised_deg, atol=1e-6)
    np.testing.assert_allclose(found_deg[:, 0], 2.0, atol=1e-6)


def test_turns_in_a_circle_add_up() -> None:
    turn_deg = np.linspace(0.0, 1000.0, 300)
    rotation = Rotation.from_euler("ZXY", np.stack([turn_deg, 0 * turn_deg + 20.0, 0 * turn_deg + 5.0], -1), True)
    found_deg = np.degrees(continuous(angles_rad(rotation.as_matrix(), (2, 0, 1)), is_proper=False))
    np.testing.assert_allclose(found_deg[:, 0], turn_deg, atol=1e-6)
    proper = Rotation.from_euler("YXY", np.stack([turn_deg, 0 * turn_deg - 20.0, -turn_deg], -1), True)
    found_deg = np.degrees(continuous(angles_rad(proper.as_matrix(), (1, 0, 1)), is_proper=True))
    np.testing.assert_allclose(found_deg[:, 0], turn_deg, atol=1e-6)


def test_smooth_rotations_have_smooth_angles_away_from_locks() -> None:
    rng = np.random.default_rng(5)
    steps = Rotation.from_rotvec(rng.normal(0.0, 0.04, (2000, 3)))
    turning = [Rotation.identity()]
    for step in steps:
        turning.append(turning[-1] * step)
    rotation = np.array([turn.as_matrix() for turn in turning])
    locked = is_locked(rotation, (2, 0, 1))
    found_rad = continuous(angles_rad(rotation, (2, 0, 1)), is_proper=False)
    np.testing.assert_allclose(Rotation.from_euler("ZXY", found_rad).as_matrix(), rotation, atol=1e-9)
    free = ~(locked[1:] | locked[:-1])
    assert locked.any()
    assert np.abs(np.diff(found_rad, axis=0))[free].max() < 1.0


def test_gaps_stay_unknown_and_nothing_jumps_after_them() -> None:
    turn_deg = np.linspace(100.0, 300.0, 50)
    rotation = Rotation.from_euler("ZXY", np.stack([turn_deg, 0 * turn_deg, 0 * turn_deg], -1), True).as_matrix()
    rotation[20:25] = np.nan
    found_deg = np.degrees(continuous(angles_rad(rotation, (2, 0, 1)), is_proper=False))[:, 0]
    assert np.isnan(found_deg[20:25]).all()
    np.testing.assert_allclose(np.delete(found_deg, range(20, 25)), np.delete(turn_deg, range(20, 25)), atol=1e-6)


def test_nothing_known_is_nothing_found() -> None:
    assert np.isnan(continuous(np.full((4, 3), np.nan), is_proper=False)).all()
    assert continuous(np.empty((0, 3)), is_proper=True).shape == (0, 3)
