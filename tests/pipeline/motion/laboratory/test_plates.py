"""Force plates of known loads by type, axes, units and zero; and by ezc3d."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest

from pipeline.core.data.laboratory import Laboratory
from pipeline.core.data.rigid import Rigid3
from pipeline.motion.laboratory.plates import force_plates
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.gait.walks import exercise
from tests.pipeline.motion.laboratory.simulated_plates import c3d_bytes, plates_m, simulated

# A foot pushes down with 800 N, 20 N forwards (+x) and 10 N to the left (+y), 0.1 m and -0.05 m from the middle.
FORCE_N = np.array([20.0, 10.0, -800.0])
PLACE_M = np.array([0.1, -0.05, 0.0])
FREE_NM = 3.0
TURNING_NM = np.array([0.0, 0.0, FREE_NM])
MIDDLE_M = np.array([1.0, 2.0, 0.0])
# Plate of 0.6 m by 0.4 m, whose X is the world's Y and whose Y is the world's X: Z points into the floor.
CORNERS_M = np.array([(0.3, 0.2, 0.0), (0.3, -0.2, 0.0), (-0.3, -0.2, 0.0), (-0.3, 0.2, 0.0)]) + MIDDLE_M
AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
DEPTH_M = 0.04
CALIBRATION = np.diag([2.0, 4.0, 0.5, 10.0, 20.0, 5.0]) + 0.01


def wrench() -> tuple[np.ndarray, np.ndarray]:
    """Force and moment about the middle of the surface along the plate's axes."""
    return AXES @ FORCE_N, AXES @ (np.cross(PLACE_M, FORCE_N) + TURNING_NM)


def channels(kind: int) -> tuple[np.ndarray, np.ndarray]:
    """Channels of a plate of a type, and its origin in millimetres; moments are in newton millimetres."""
    force, moment = wrench()
    if kind == 1:
        x_m, y_m = -moment[1] / force[2], moment[0] / force[2]
        turning = moment[2] - (x_m * force[1] - y_m * force[0])
        return np.array([*force, x_m * 1000.0, y_m * 1000.0, turning * 1000.0]), np.zeros(3)
    if kind == 3:
        a, b = 0.12, 0.2
        below = moment + np.cross([0.0, 0.0, -DEPTH_M], force)
        # Four vertical forces, and the sums along the sides, with these moments.
        z = np.linalg.lstsq(
            np.array([[1, 1, 1, 1], [b, b, -b, -b], [-a, a, a, -a]]), [force[2], below[0], below[1]], rcond=None
        )[0]
        sides = np.linalg.lstsq(
            np.array([[1, 1, 0, 0], [0, 0, 1, 1], [-b, b, a, -a]]), [force[0], force[1], below[2]], rcond=None
        )[0]
        return np.array([*sides, *z]), np.array([a, b, -DEPTH_M]) * 1000.0
    # The transducer is below the surface.
    below = moment + np.cross([0.0, 0.0, -DEPTH_M], force)
    values = np.array([*force, *below * 1000.0])
    return (np.linalg.solve(CALIBRATION, values) if kind == 4 else values), np.array([0.0, 0.0, -DEPTH_M]) * 1000.0


def plate_of(kind: int, sign: float = 1.0, **changed: Any) -> Laboratory:
    values, origin_mm = channels(kind)
    samples = np.zeros((20, len(values)), np.float32)
    samples[10:] = sign * values
    moments = ["mm", "mm", "Nmm"] if kind == 1 else ["Nmm"] * 3
    groups = {
        "ANALOG": {"UNITS": ["N"] * 3 + (moments if kind != 3 else ["N"] * 5), "SCALE": np.ones(len(values), "f4")},
        "FORCE_PLATFORM": {
            "USED": np.array([1], "u2"),
            "TYPE": np.array([kind], "u2"),
            "CORNERS": (CORNERS_M * 1000.0).astype("f4")[None],
            "ORIGIN": origin_mm.astype("f4")[None],
            "CHANNEL": np.arange(1, len(values) + 1, dtype="u2")[None],
            "CAL_MATRIX": CALIBRATION.T.astype("f4")[None],
        }
        | changed,
    }
    world = Rigid3(np.eye(3), np.zeros(3))
    return Laboratory("a.c3d", "mm", 100.0, 10, 2, samples, groups, (), world)


@pytest.mark.parametrize(("kind", "sign"), [(1, 1.0), (2, 1.0), (2, -1.0), (3, 1.0), (3, -1.0), (4, 1.0)])
def test_force_and_pressure_of_each_type(kind: int, sign: float) -> None:
    (plate,) = force_plates(plate_of(kind, sign))
    np.testing.assert_allclose(plate.corners_m, CORNERS_M, atol=1e-6)
    # Of the floor on the foot.
    np.testing.assert_allclose(plate.force_n[15], -FORCE_N, atol=1e-3)
    np.testing.assert_allclose(plate.moment_nm[15], -np.cross(PLACE_M, FORCE_N) - TURNING_NM, atol=1e-3)
    np.testing.assert_allclose(plate.centre_of_pressure_m[15], PLACE_M + MIDDLE_M, atol=1e-5)
    assert np.isnan(plate.centre_of_pressure_m[5]).all()


def test_origin_above_the_surface_counts_as_below() -> None:
    _, origin_mm = channels(2)
    (plate,) = force_plates(plate_of(2, ORIGIN=-origin_mm.astype("f4")[None]))
    np.testing.assert_allclose(plate.centre_of_pressure_m[15], PLACE_M + MIDDLE_M, atol=1e-5)


def test_unit_of_moments_is_honoured() -> None:
    laboratory = plate_of(2)
    samples = laboratory.samples.copy()
    samples[:, 3:] /= 1000.0
    groups = {**laboratory.groups, "ANALOG": {"UNITS": ["N", "N", "N", "Nm", "N.m", "N*m"]}}
    (plate,) = force_plates(replace(laboratory, samples=samples, groups=groups))
    np.testing.assert_allclose(plate.centre_of_pressure_m[15], PLACE_M + MIDDLE_M, atol=1e-5)


def test_zero_is_subtracted() -> None:
    laboratory = plate_of(2, ZERO=np.array([1, 5], "u2"))
    (plate,) = force_plates(replace(laboratory, samples=laboratory.samples + np.float32(30.0)))
    np.testing.assert_allclose(plate.force_n[15], -FORCE_N, atol=1e-3)
    np.testing.assert_allclose(plate.force_n[:10], 0.0, atol=1e-6)


def test_plates_turn_with_the_world() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    world = Rigid3(quarter, np.array([0.0, 0.0, 0.3]))
    (plate,) = force_plates(replace(plate_of(2), world_from_laboratory=world))
    np.testing.assert_allclose(plate.force_n[15], -quarter @ FORCE_N, atol=1e-3)
    np.testing.assert_allclose(plate.centre_of_pressure_m[15], world.apply(PLACE_M + MIDDLE_M), atol=1e-5)


def test_plate_of_unknown_type_is_left_out() -> None:
    assert force_plates(plate_of(2, TYPE=np.array([12], "u2"))) == ()


def test_plates_are_those_of_ezc3d(tmp_path: Path) -> None:
    act = exercise(Gesture.JUMP)
    laboratory = simulated(act, 0.0, 4.0, plates_m(act, ((0.2, 0.0), (0.8, 0.0))))
    (tmp_path / "a.c3d").write_bytes(c3d_bytes(laboratory))
    others = ezc3d.c3d(str(tmp_path / "a.c3d"), extract_forceplat_data=True)["data"]["platform"]
    for plate, other in zip(force_plates(laboratory), others, strict=True):
        np.testing.assert_allclose(np.abs(other["force"].T), np.abs(plate.force_n), atol=1e-3)
        known = np.isfinite(plate.centre_of_pressure_m[:, 0])
        pressure_m = other["center_of_pressure"].T[known] / 1000.0
        np.testing.assert_allclose(pressure_m, plate.centre_of_pressure_m[known], atol=1e-4)
    assert np.isfinite(force_plates(laboratory)[0].centre_of_pressure_m).any()


def test_unit_of_thousands_of_newtons_is_honoured() -> None:
    laboratory = plate_of(2)
    groups = {**laboratory.groups, "ANALOG": {"UNITS": ["kN"] * 3 + ["kNm"] * 3}}
    scaled = laboratory.samples / np.array([1e3, 1e3, 1e3, 1e6, 1e6, 1e6], "f4")
    (plate,) = force_plates(replace(laboratory, samples=scaled, groups=groups))
    np.testing.assert_allclose(plate.force_n[15], -FORCE_N, rtol=1e-4)
    np.testing.assert_allclose(plate.centre_of_pressure_m[15], PLACE_M + MIDDLE_M, atol=1e-5)


@pytest.mark.parametrize(
    "elsewhere_mm", [np.zeros((4, 3)), np.diag([-5.9e10, 9.0e15, 3.0, 1.0])[:, :3]], ids=["place", "left-over bytes"]
)
def test_plate_without_corners_is_left_out(elsewhere_mm: np.ndarray) -> None:
    changed: dict[str, Any] = {"USED": np.array([2], "u2"), "TYPE": np.array([2, 2], "u2")}
    changed |= {name: np.repeat(plate_of(2).numbers("FORCE_PLATFORM", name), 2, 0) for name in ("ORIGIN", "CHANNEL")}
    corners = np.stack([elsewhere_mm, CORNERS_M * 1000.0]).astype("f4")
    (plate,) = force_plates(plate_of(2, CORNERS=corners, **changed))
    np.testing.assert_allclose(plate.corners_m, CORNERS_M, atol=1e-6)


def test_channel_0_is_refused() -> None:
    with pytest.raises(ValueError, match="lacks a channel"):
        force_plates(plate_of(2, CHANNEL=np.arange(6, dtype="u2")[None]))


def test_offset_of_signed_samples_is_signed() -> None:
    laboratory = plate_of(2)
    offset = np.full(6, -30, "i2").view("u2")
    groups = {**laboratory.groups, "ANALOG": {**laboratory.groups["ANALOG"], "OFFSET": offset}}
    shifted = replace(laboratory, samples=laboratory.samples - np.float32(30.0), groups=groups)
    np.testing.assert_allclose(force_plates(shifted)[0].force_n[15], -FORCE_N, atol=1e-3)
    groups["ANALOG"] = {**groups["ANALOG"], "FORMAT": ["UNSIGNED"]}
    raised = replace(laboratory, samples=laboratory.samples + np.float32(65_506.0), groups=groups)
    np.testing.assert_allclose(force_plates(raised)[0].force_n[15], -FORCE_N, atol=0.01)
