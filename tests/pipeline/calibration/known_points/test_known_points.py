"""A world from known points: tables, checks, alignment, reasons for a misfit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.known_points.fit import place_by_points, read_known_points
from pipeline.calibration.known_points.point_checks import point_problems
from pipeline.calibration.similarity import Similarity
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import KnownPoint
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

CAMERAS = tuple(build_cameras(Rig(Layout.RING, 4, (3.0, 2.5), 2.0), np.random.default_rng(0)))
SIZES = {camera.name: camera.size_px for camera in CAMERAS}
XYZ_M = np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.2], [0.0, 0.8, 0.1], [-0.6, -0.4, 0.3], [0.3, -0.5, 1.1]])
MOVE = Similarity(1.0, Rotation.from_rotvec([0.4, -0.9, 2.0]).as_matrix(), np.array([0.5, -2.0, 1.0]))


def read_points(xyz_m: np.ndarray = XYZ_M, noise_px: float = 0.0) -> tuple[KnownPoint, ...]:
    """Points whose true places are ``XYZ_M``, with the coordinates that a user states."""
    rng = np.random.default_rng(1)
    seen_px = [project(camera, XYZ_M) + rng.normal(0.0, noise_px, (len(XYZ_M), 2)) for camera in CAMERAS]
    return tuple(
        KnownPoint(
            f"P{k}",
            (float(x), float(y), float(z)),
            tuple(
                (camera.name, float(one[k, 0]), float(one[k, 1]))
                for camera, one in zip(CAMERAS, seen_px, strict=True)
                if (one[k] >= 0).all() and (one[k] < camera.size_px).all()
            ),
        )
        for k, (x, y, z) in enumerate(xyz_m)
    )


def moved(scale: float = 1.0) -> tuple[Camera, ...]:
    """The rig somewhere else, as the adjustment leaves it."""
    return tuple(MOVE._replace(scale=scale).moved(camera) for camera in CAMERAS)


def refusal(points: tuple[KnownPoint, ...], keeps_scale: bool = True) -> Problem:
    """The only problem of points that are refused."""
    with pytest.raises(InputError) as raised:
        place_by_points(moved(), points, keeps_scale)
    (problem,) = raised.value.problems
    return problem


@pytest.mark.parametrize(("scale", "keeps_scale"), [(1.0, True), (0.85, False)])
def test_cameras_come_back_into_world(scale: float, keeps_scale: bool) -> None:
    placed = place_by_points(moved(scale), read_points(), keeps_scale)
    for found, truth in zip(placed.cameras, CAMERAS, strict=True):
        np.testing.assert_allclose(found.cam_from_world.rotation, truth.cam_from_world.rotation, atol=1e-6)
        np.testing.assert_allclose(center_in_world(found), center_in_world(truth), atol=1e-5)
    assert placed.scale == pytest.approx(1.0 / scale)
    assert placed.warnings == ()


def test_marks_of_pixel_place_cameras_to_centimetre() -> None:
    placed = place_by_points(moved(), read_points(noise_px=1.0), keeps_scale=True)
    errors_m = [
        np.linalg.norm(center_in_world(a) - center_in_world(b)) for a, b in zip(placed.cameras, CAMERAS, strict=True)
    ]
    assert max(errors_m) < 0.02
    assert "5 known points" in placed.world


@pytest.mark.parametrize(
    ("xyz_m", "words"),
    [
        (1000.0 * XYZ_M, "millimetres"),
        (100.0 * XYZ_M, "centimetres"),
        (1.1 * XYZ_M, "1.1 times"),
        (XYZ_M[:, [1, 0, 2]], "mirrored"),
        (XYZ_M + np.array([[0.0], [0.0], [0.0], [0.7], [0.0]]), "Check P3"),
        (np.random.default_rng(3).uniform(-1, 1, (5, 3)), "Check the names"),
    ],
)
def test_points_that_do_not_fit_are_refused_with_reason(xyz_m: np.ndarray, words: str) -> None:
    problem = refusal(read_points(xyz_m))
    assert problem.code == "known_points_misfit"
    assert words in str(problem)


def test_all_that_is_wrong_with_points_is_listed() -> None:
    line = read_points(np.array([[0.0, 0.0, 0.0], [1.0, 0.01, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [4.0, 0.0, 0.0]]))
    assert [one.code for one in point_problems(line, SIZES)] == ["known_points_on_a_line"]
    assert [one.code for one in point_problems(line[:2], SIZES)] == ["known_points_few"]
    alone = replace(read_points()[0], seen_px=read_points()[0].seen_px[:1])
    (few,) = point_problems((alone, *read_points()[1:3]), SIZES)
    assert "P0" in (few.hint or "")
    strange = KnownPoint("P1", (0.0, 0.0, 0.0), (("cam_x", 1.0, 2.0), (CAMERAS[0].name, -40.0, 2.0)))
    found = point_problems((*read_points(), strange), SIZES)
    assert [one.code for one in found] == ["known_points_invalid", "camera_unknown", "known_points_invalid"]
    assert (found[1].camera, found[2].camera) == ("cam_x", CAMERAS[0].name)


def test_table_is_read(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    rows = ["name, x_m, y_m, z_m, camera, x_px, y_px", "door,0,1.5,0,cam_1,10.5,20", "door,0,1.5,0,cam_2,30,40"]
    path.write_text("\n".join([*rows, "desk,1,2,0.75,cam_1,1,2"]), encoding="utf-8-sig")
    door, desk = read_known_points(path)
    assert door == KnownPoint("door", (0.0, 1.5, 0.0), (("cam_1", 10.5, 20.0), ("cam_2", 30.0, 40.0)))
    assert desk.seen_px == (("cam_1", 1.0, 2.0),)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("door,0,1.6,0,cam_2,30,40", "other coordinates"),
        ("desk,0,a,0,cam_2,30,40", "Line 3"),
        ("desk,0,nan,0,cam_2,30,40", "not finite"),
        ("desk,0,1,0,,30,40", "lacks the name"),
        ("desk,0,1", "a coordinate that is not a number"),
    ],
)
def test_wrong_line_is_named(tmp_path: Path, row: str, words: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"name,x_m,y_m,z_m,camera,x_px,y_px\ndoor,0,1.5,0,cam_1,10.5,20\n{row}\n")
    with pytest.raises(InputError) as raised:
        read_known_points(path)
    assert words in str(raised.value)


def test_something_else_than_table_is_refused(tmp_path: Path) -> None:
    for content in (b"\xff\xfe\x00", b"name,x\n1,2\n", b""):
        (tmp_path / "points.csv").write_bytes(content)
        with pytest.raises(InputError, match="table"):
            read_known_points(tmp_path / "points.csv")
