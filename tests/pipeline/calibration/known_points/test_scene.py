"""Calibration from a scene: poses and lenses against simulated cameras, wrong and exchanged points, what is refused."""

from collections.abc import Sequence

import numpy as np
import pytest

from pipeline.calibration.known_points.scene import calibrate_scene, scene_cameras
from pipeline.calibration.report import CalibrationResult, report_document
from pipeline.calibration.sizes import guessed_camera
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import KnownPoint
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

CAMERAS = tuple(build_cameras(Rig(Layout.RING, 3, (3.0, 2.5), 2.0), np.random.default_rng(0)))
GUESSES = tuple(guessed_camera(camera.name, camera.size_px) for camera in CAMERAS)
# Two boxes on the floor, and marks of the floor itself.
BOXES_M = np.array(
    [
        [0, 0, 0],
        [0.8, 0, 0],
        [0, 0.6, 0],
        [0.8, 0.6, 0],
        [0, 0, 1.1],
        [0.8, 0.6, 1.1],
        [-0.7, -0.5, 0.5],
        [0.5, -0.6, 0.9],
    ]
)
FLOOR_M = 0.4 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 0], [0.5, 0.2, 0]], float)
Seen = dict[str, np.ndarray]


def marked(xyz_m: np.ndarray, noise_px: float = 0.0, cameras: Sequence[Camera] = CAMERAS) -> Seen:
    """Marks of all points in each camera."""
    rng = np.random.default_rng(3)
    return {camera.name: project(camera, xyz_m) + rng.normal(0, noise_px, (len(xyz_m), 2)) for camera in cameras}


def known(xyz_m: np.ndarray, seen: Seen) -> list[KnownPoint]:
    return [
        KnownPoint(f"P{k}", (x, y, z), tuple((camera, *px[k].tolist()) for camera, px in seen.items() if k < len(px)))
        for k, (x, y, z) in enumerate(xyz_m.tolist())
    ]


def pose_error(found: CalibrationResult) -> tuple[float, float]:
    """Largest errors of the places in metres, and of the turns in degrees."""
    places, turns = [], []
    for camera, truth in zip(found.cameras, CAMERAS, strict=True):
        places.append(np.linalg.norm(center_in_world(camera) - center_in_world(truth)))
        turn = camera.cam_from_world.rotation @ truth.cam_from_world.rotation.T
        turns.append(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))
    return float(max(places)), float(max(turns))


def refusals(xyz_m: np.ndarray, seen: Seen, cameras: Sequence[Camera] = CAMERAS, lens: bool = True) -> list[Problem]:
    with pytest.raises(InputError) as raised:
        calibrate_scene(cameras, known(xyz_m, seen), lens)
    return list(raised.value.problems)


@pytest.mark.parametrize("xyz_m", [BOXES_M, FLOOR_M, FLOOR_M[:4]], ids=["boxes", "floor", "four on the floor"])
def test_exact_marks_give_exact_poses(xyz_m: np.ndarray) -> None:
    found = calibrate_scene(CAMERAS, known(xyz_m, marked(xyz_m)), has_intrinsics=True)
    place_m, turn_deg = pose_error(found)
    assert place_m < 1e-6
    assert turn_deg < 1e-5
    assert found.warnings == ()


def test_marks_off_by_a_pixel_give_deviations_of_pose() -> None:
    found = calibrate_scene(CAMERAS, known(BOXES_M, marked(BOXES_M, 1.0)), has_intrinsics=True)
    place_m, turn_deg = pose_error(found)
    assert place_m < 0.03
    assert turn_deg < 0.5
    stated_m = max(camera.position_sigma_mm for camera in found.by_camera) / 1000
    assert 0.3 * place_m < stated_m < 3 * place_m
    assert found.warnings == ()
    assert "8 known points, which fit by 1." in found.world


def test_report_has_error_of_each_point() -> None:
    seen = marked(BOXES_M)
    seen["cam_01"][2] += [3.0, 4.0]
    document = report_document(calibrate_scene(CAMERAS, known(BOXES_M, seen), has_intrinsics=True))
    assert [point["name"] for point in document["cameras"][1]["points"]] == [f"P{k}" for k in range(8)]
    errors_px = [point["error_px"] for point in document["cameras"][1]["points"]]
    assert np.argmax(errors_px) == 2
    assert 2.0 < errors_px[2] < 5.0
    assert document["cameras"][0]["points"][3]["projected_px"] == pytest.approx(seen["cam_00"][3], abs=0.01)


@pytest.mark.parametrize(("xyz_m", "place_m"), [(BOXES_M, 0.12), (FLOOR_M, 0.5)], ids=["boxes", "floor"])
def test_unknown_lens_is_estimated(xyz_m: np.ndarray, place_m: float) -> None:
    found = calibrate_scene(GUESSES, known(xyz_m, marked(xyz_m, 0.5)), has_intrinsics=False)
    assert pose_error(found)[0] < place_m
    for camera, truth in zip(found.cameras, CAMERAS, strict=True):
        assert camera.matrix[0, 0] == pytest.approx(truth.matrix[0, 0], rel=0.04 if xyz_m is BOXES_M else 0.15)
    assert all(camera.focal_sigma_percent > 0.5 for camera in found.by_camera)
    assert "Lenses are estimated" in found.world


def test_wrong_and_exchanged_points_are_named() -> None:
    seen = marked(BOXES_M, 0.5)
    seen["cam_01"][3] += [30, 28]
    seen["cam_02"][[1, 5]] = seen["cam_02"][[5, 1]]
    wrong, *exchanged = refusals(BOXES_M, seen)
    assert (wrong.code, wrong.camera) == ("known_points_misfit", "cam_01")
    assert wrong.message.startswith("The point P3 is 41 px off; without it the error is 0.")
    assert [problem.camera for problem in exchanged] == ["cam_02", "cam_02"]
    assert "exchanged with P5" in str(exchanged[0].hint)
    assert "exchanged with P1" in str(exchanged[1].hint)


@pytest.mark.parametrize("has_intrinsics", [True, False])
def test_wrong_coordinates_get_place_that_cameras_see(has_intrinsics: bool) -> None:
    stated_m = BOXES_M.copy()
    stated_m[4, 2] = 1.3
    cameras = CAMERAS if has_intrinsics else GUESSES
    (problem,) = refusals(stated_m, marked(BOXES_M, 0.5), cameras, has_intrinsics)
    assert "coordinates of the point P4" in problem.message
    place_m = [float(word.strip(",")) for word in str(problem.hint).split()[4:7]]
    np.testing.assert_allclose(place_m, BOXES_M[4], atol=0.01)


@pytest.mark.parametrize("has_intrinsics", [True, False])
def test_mirrored_points_are_refused(has_intrinsics: bool) -> None:
    cameras = CAMERAS if has_intrinsics else GUESSES
    problems = refusals(BOXES_M * [1, -1, 1], marked(BOXES_M, 0.5), cameras, has_intrinsics)
    assert [problem.camera for problem in problems] == ["cam_00", "cam_01", "cam_02"]
    assert all("only when they are mirrored" in problem.message for problem in problems)


def test_mirrored_floor_and_wrong_unit_are_doubted() -> None:
    """Marks of a mirrored plane fit cameras below it, and marks in millimetres fit cameras far apart."""
    mirrored = calibrate_scene(CAMERAS, known(FLOOR_M * [1, -1, 1], marked(FLOOR_M)), has_intrinsics=True)
    assert "upside_down" in {warning.code for warning in mirrored.warnings}
    far = calibrate_scene(CAMERAS, known(1000 * BOXES_M, marked(BOXES_M)), has_intrinsics=True)
    (warning,) = far.warnings
    assert warning.code == "world_unit"
    assert "mm" in str(warning.hint)


def test_upright_axis_is_turned_to_z() -> None:
    y_up_m = BOXES_M[:, [0, 2, 1]] * [1, 1, -1]
    found = calibrate_scene(CAMERAS, known(y_up_m, marked(BOXES_M)), True, up="y")
    assert {warning.code for warning in found.warnings} == set()
    heights_m = [float(center_in_world(camera)[2]) for camera in found.cameras]
    np.testing.assert_allclose(heights_m, [center_in_world(camera)[2] for camera in CAMERAS], atol=1e-6)


def test_few_points_points_on_line_and_unknown_cameras_are_all_named() -> None:
    line_m = np.array([[0.2 * k, 0, 0.5] for k in range(4)])
    seen = {"cam_00": marked(line_m)["cam_00"], "cam_01": marked(line_m)["cam_01"][:3], "other": np.zeros((4, 2))}
    problems = refusals(line_m, seen)
    assert [(problem.code, problem.camera) for problem in problems] == [
        ("camera_unknown", "other"),
        ("known_points_on_a_line", "cam_00"),
        ("known_points_few", "cam_01"),
        ("known_points_few", "cam_02"),
    ]
    assert "3 points are marked; the camera needs 4." in problems[2].message
    (problem,) = refusals(BOXES_M[:5], marked(BOXES_M[:5], cameras=CAMERAS[:1]), GUESSES[:1], lens=False)
    assert problem.message == "5 points are marked; the camera needs 6 while its lens is not known."


def test_cameras_have_lens_of_calibration_at_size_of_picture() -> None:
    points = known(BOXES_M, marked(BOXES_M))
    half, unsized = scene_cameras(points[:1], {"cam_00": (640, 360), "cam_01": (1280, 720)}, CAMERAS)[:2]
    assert half.size_px == (640, 360)
    assert half.matrix[0, 0] == pytest.approx(CAMERAS[0].matrix[0, 0] / 2)
    assert unsized is CAMERAS[1]
    (guess, *_) = scene_cameras(points, {"": (800, 600)}, None)
    assert (guess.name, guess.size_px, guess.matrix[0, 0]) == ("cam_00", (800, 600), 800.0)
    with pytest.raises(InputError) as raised:
        scene_cameras(points, {"cam_00": (500, 720)}, CAMERAS[:2])
    assert [(problem.code, problem.camera) for problem in raised.value.problems] == [
        ("invalid_size", "cam_00"),
        ("camera_unknown", "cam_02"),
    ]
    with pytest.raises(InputError) as raised:
        scene_cameras(points, {}, None)
    assert [problem.code for problem in raised.value.problems] == ["invalid_size"] * 3


def test_far_plane_is_doubted() -> None:
    """A small plane that is seen from afar leaves two poses, and a vague focal length."""
    tiny_m = np.array([[x, y, 1.0] for x in (0.0, 0.12) for y in (0.0, 0.12)])
    found = calibrate_scene(CAMERAS, known(tiny_m, marked(tiny_m, 0.5)), has_intrinsics=True)
    assert {warning.code for warning in found.warnings if warning.camera} >= {"known_points_doubtful"}


def test_tiny_scene_has_exact_poses_in_its_unit() -> None:
    found = calibrate_scene(CAMERAS, known(1e-4 * BOXES_M, marked(BOXES_M)), has_intrinsics=True)
    for camera, truth in zip(found.cameras, CAMERAS, strict=True):
        np.testing.assert_allclose(center_in_world(camera), 1e-4 * center_in_world(truth), atol=1e-9)


def test_marks_at_one_place_are_refused() -> None:
    seen = {camera.name: np.full((8, 2), 100.0) for camera in CAMERAS}
    assert {problem.code for problem in refusals(BOXES_M, seen)} == {"known_points_misfit"}


def test_marks_of_no_scene_are_refused() -> None:
    rng = np.random.default_rng(5)
    seen = {camera.name: rng.uniform([0, 0], camera.size_px, (8, 2)) for camera in CAMERAS}
    problems = refusals(BOXES_M, seen)
    assert len(problems) == 3
    assert all("no half of them fits" in problem.message for problem in problems)


def test_points_without_marks_are_named() -> None:
    points = known(BOXES_M, {})
    with pytest.raises(InputError) as raised:
        calibrate_scene(scene_cameras(points, {}, None), points, has_intrinsics=False)
    (problem,) = raised.value.problems
    assert (problem.code, problem.field) == ("known_points_few", "known_points")
    assert problem.message == "No camera sees a point."
