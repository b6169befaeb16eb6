"""Calibration from people, against exact cameras."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.people.calibrate_people import calibrate_people
from pipeline.calibration.sizes import guessed_camera
from pipeline.core.data.cameras import FrameTimes
from pipeline.core.errors import InputError
from pipeline.core.options.job_choices import KnownPoint
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.evaluation.camera_errors import camera_errors
from pipeline.validation.simulation.scenes import Simulation
from tests.cases import accuracy_but
from tests.pipeline.calibration.people.conftest import bare, room, without

DISTANCE_MM = 4000.0


def statures_m(simulation: Simulation) -> list[float]:
    """Statures as shin, thigh and trunk tell them."""
    names = simulation.joints.names
    left = {
        kind: simulation.truth_m[:, :, names.index(f"left_{kind}")] for kind in ("ankle", "knee", "hip", "shoulder")
    }
    right = {kind: simulation.truth_m[:, :, names.index(f"right_{kind}")] for kind in ("hip", "shoulder")}
    trunk = (left["shoulder"] + right["shoulder"] - left["hip"] - right["hip"]) / 2
    bones = (left["ankle"] - left["knee"], left["knee"] - left["hip"], trunk)
    total_m = sum(np.nanmedian(np.linalg.norm(bone, axis=-1), axis=-1) for bone in bones)
    return [float(one) for one in np.atleast_1d(total_m) / (0.246 + 0.245 + 0.288)]


def problems_of(simulation: Simulation, **changes: object) -> dict[str, str | None]:
    """Codes of the problems, with their cameras."""
    given = {"times": simulation.times, "detections": simulation.detections} | changes
    with pytest.raises(InputError) as refused:
        calibrate_people(bare(simulation.cameras), given["times"], given["detections"], simulation.joints, [1.7], True)  # type: ignore[arg-type]
    return {problem.code: problem.camera for problem in refused.value.problems}


@pytest.mark.slow
def test_people_place_cameras_in_level_world_of_their_scale(walk: Simulation) -> None:
    shares: list[float] = []
    made = calibrate_people(
        bare(walk.cameras), walk.times, walk.detections, walk.joints, statures_m(walk), True, shares.append
    )
    errors = camera_errors(walk.cameras, made.cameras)
    assert errors["rotation_deg"] < 0.3
    assert errors["translation_mm"] < 0.01 * DISTANCE_MM
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    for true, found in zip(walk.cameras, made.cameras, strict=True):
        # Heights tell scale, floor and vertical; the true world has its floor at 0.
        assert center_in_world(found)[2] == pytest.approx(center_in_world(true)[2], abs=0.06)
        turn = found.cam_from_world.rotation.T @ true.cam_from_world.rotation
        assert np.degrees(np.arccos(min(1.0, turn[2, 2]))) < 0.7
    # y points away from the first camera, and the origin lies under the people.
    x_m, y_m, _ = center_in_world(made.cameras[0])
    assert abs(x_m) < 1e-6
    assert y_m < -2.0
    assert [one.focal_sigma_percent for one in made.by_camera] == pytest.approx([np.nan] * 3, nan_ok=True)
    assert made.by_camera[1].position_sigma_mm < 30.0
    assert "scale from a stature of" in made.world
    assert not made.warnings


@pytest.mark.slow
def test_guessed_lenses_are_estimated() -> None:
    simulation = room(3, seed=1, duration_s=20.0)
    guessed = [guessed_camera(camera.name, camera.size_px) for camera in simulation.cameras]
    made = calibrate_people(
        guessed, simulation.times, simulation.detections, simulation.joints, statures_m(simulation), False
    )
    for true, found in zip(simulation.cameras, made.cameras, strict=True):
        assert guessed_camera(true.name, true.size_px).matrix[0, 0] > 1.5 * true.matrix[0, 0]
        assert found.matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=0.04)
    # The principal point stays in the middle, up to 13 px from the true one.
    assert camera_errors(simulation.cameras, made.cameras)["rotation_deg"] < 1.5
    assert all(0.0 < one.focal_sigma_percent < 2.0 for one in made.by_camera)


def test_missing_value_is_named_with_camera(walk: Simulation) -> None:
    nobody = dict(walk.detections) | {"cam_01": without(walk.detections["cam_01"])}
    assert problems_of(walk, detections=nobody) == {"people_not_found": "cam_01"}
    late = dict(walk.times) | {"cam_01": FrameTimes(walk.times["cam_01"].time_s + 100.0)}
    assert problems_of(walk, times=late) == {"people_unlinked": "cam_01"}
    alone = replace(walk, cameras=walk.cameras[:1])
    assert problems_of(alone) == {"people_one_camera": None}


@pytest.mark.slow
def test_wrong_clock_and_video_given_twice_are_named(walk: Simulation) -> None:
    times = dict(walk.times) | {"cam_02": FrameTimes(walk.times["cam_02"].time_s + 0.5)}
    late = calibrate_people(bare(walk.cameras), times, walk.detections, walk.joints, [1.7], True)
    assert {(one.code, one.camera) for one in late.warnings} == {("people_poor_fit", "cam_02")}
    same = dict(walk.detections) | {"cam_01": replace(walk.detections["cam_00"], camera="cam_01")}
    twice = calibrate_people(bare(walk.cameras), walk.times, same, walk.joints, [1.7], True)
    assert ("people_same_place", "cam_01") in {(one.code, one.camera) for one in twice.warnings}


@pytest.mark.slow
def test_known_points_make_world_and_its_scale(walk: Simulation) -> None:
    xyz_m = np.array([[0.8, 0.6, 0.0], [-0.9, 0.2, 0.1], [0.2, -0.7, 1.2]])
    seen_px = {camera.name: project(camera, xyz_m).tolist() for camera in walk.cameras}
    points = tuple(
        KnownPoint(f"P{k}", (x_m, y_m, z_m), tuple((name, one[k][0], one[k][1]) for name, one in seen_px.items()))
        for k, (x_m, y_m, z_m) in enumerate(xyz_m.tolist())
    )
    # The stature is wrong by a tenth, and does not count.
    given = [1.1 * one for one in statures_m(walk)]
    made = calibrate_people(
        bare(walk.cameras), walk.times, walk.detections, walk.joints, given, True, known_points=points
    )
    assert "3 known points" in made.world
    for true, found in zip(walk.cameras, made.cameras, strict=True):
        assert np.linalg.norm(center_in_world(found) - center_in_world(true)) < 0.01 * DISTANCE_MM / 1000


@pytest.mark.slow
@pytest.mark.parametrize(("num_cameras", "seed"), accuracy_but([(4, 3)], [(4, 1), (4, 2), (4, 3), (8, 1), (8, 4)]))
def test_rooms_of_minute(num_cameras: int, seed: int) -> None:
    simulation = room(num_cameras, seed)
    made = calibrate_people(
        bare(simulation.cameras), simulation.times, simulation.detections, simulation.joints, [1.7], True
    )
    errors = camera_errors(simulation.cameras, made.cameras)
    assert errors["rotation_deg"] <= 0.3
    assert errors["translation_mm"] <= 0.01 * DISTANCE_MM
