import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.association.tracking.tracking_parameters import viewed_point_m
from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import MAX_BYTES, read_calibration, read_contents
from pipeline.calibration.write import encode
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError
from pipeline.core.options.job_choices import Units
from pipeline.core.runtime.packages import samples
from pipeline.geometry.camera import center_in_world, project
from pipeline.geometry.undistortion import undistort_px

IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def own(**changes: Any) -> dict[str, Any]:
    """Camera in Multicap's format with some fields changed."""
    camera = {
        "name": "left",
        "size_px": [640, 480],
        "matrix": [[500.0, 0.0, 319.5], [0.0, 500.0, 239.5], [0.0, 0.0, 1.0]],
        "distortion": [],
        "rotation": IDENTITY,
        "translation_m": [0.0, 0.0, 3.0],
    }
    return camera | changes


def write_own(path: Path, cameras: list[dict[str, Any]]) -> Path:
    path.write_text(json.dumps({"schema_version": 1, "cameras": cameras}))
    return path


def problems_of(path: Path) -> list[tuple[str, str | None, str | None]]:
    with pytest.raises(InputError) as error:
        read_calibration(path)
    assert all(problem.file == path.name for problem in error.value.problems)
    return [(problem.code, problem.camera, problem.field) for problem in error.value.problems]


@given(
    angles=st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
    focal_px=st.floats(50.0, 5000.0),
    num_coefficients=st.sampled_from([0, 4, 5, 8, 12]),
)
def test_written_file_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, angles: list[float], focal_px: float, num_coefficients: int
) -> None:
    camera = Camera(
        "Kamera 1 é",
        (1088, 1920),
        np.array([[focal_px, 0.0, 543.25], [0.0, focal_px * 1.01, 960.5], [0.0, 0.0, 1.0]]),
        np.linspace(-0.1, 0.1, num_coefficients),
        Rigid3(Rotation.from_rotvec(angles).as_matrix(), np.array([0.1, -2.0, 3.3])),
    )
    path = tmp_path_factory.mktemp("calibration") / "cameras.json"
    path.write_bytes(encode([camera]))
    (again,) = read_calibration(path)
    assert (again.name, again.size_px) == (camera.name, camera.size_px)
    for a, b in (
        (again.matrix, camera.matrix),
        (again.distortion, camera.distortion),
        (again.cam_from_world.rotation, camera.cam_from_world.rotation),
        (again.cam_from_world.translation_m, camera.cam_from_world.translation_m),
    ):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_toml_of_caliscope_and_anipose(tmp_path: Path) -> None:
    path = tmp_path / "camera_array.toml"
    path.write_text(
        """
[cam_0]
name = "front"
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [-0.1, 0.02, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 1.5707963267948966]
translation = [0.5, 0.0, 4.0]
fisheye = false

[cam_1]
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 4.0]

[metadata]
adjusted = true
"""
    )
    front, second = read_calibration(path)
    assert (front.name, second.name) == ("front", "cam_1")
    # A quarter turn about the optical axis maps x to y: (1, 0, 0) is seen at (0.5, 1) / 4, below the centre.
    r2 = 0.125**2 + 0.25**2
    below_px = 501.0 * 0.25 * (1 - 0.1 * r2 + 0.02 * r2**2)
    np.testing.assert_allclose(project(front, np.array([1.0, 0.0, 0.0]))[1], 240.0 + below_px, rtol=1e-9)


def test_short_names_of_benchmark_conversions(tmp_path: Path) -> None:
    path = tmp_path / "shelf.json"
    camera = {
        "name": "Camera0",
        "width": 1032,
        "height": 776,
        "K": own()["matrix"],
        "dist": [0, 0, 0, 0, 0],
        "R": IDENTITY,
        "t": [0.0, 0.0, 2.0],
    }
    path.write_text(json.dumps({"convention": "x = K (R X + t)", "cameras": [camera]}))
    (read,) = read_calibration(path)
    assert (read.name, read.size_px) == ("Camera0", (1032, 776))
    np.testing.assert_allclose(center_in_world(read), [0.0, 0.0, -2.0])


def test_qualisys_cameras_look_at_stage_from_above_floor() -> None:
    sample = samples.locate()
    if sample is None:
        pytest.skip("the sample capture is not installed (`multicap samples install`)")
    cameras = read_calibration(sample.calibration)
    assert [camera.name for camera in cameras] == ["cam01", "cam02", "cam03", "cam04"]
    assert all(camera.size_px == (1088, 1920) for camera in cameras)
    # 107599.671875 / 64, and the camera's centre in the file, in millimetres.
    np.testing.assert_allclose(cameras[0].matrix[0, 0], 1681.244873, atol=1e-6)
    np.testing.assert_allclose(center_in_world(cameras[0]), [1.4602323709, -1.9091590482, 1.8965058524], atol=1e-9)
    target_m = viewed_point_m(cameras)
    for camera in cameras:
        assert 0.5 < center_in_world(camera)[2] < 4.0
        assert camera.cam_from_world.apply(target_m)[2] > 1.0
        assert np.linalg.norm(project(camera, target_m) - np.array([543.5, 959.5])) < 150


@pytest.mark.parametrize(
    ("changes", "code", "field"),
    [
        ({"matrix": [[500.0, 0.0, float("nan")], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]}, "invalid_matrix", "matrix"),
        ({"matrix": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]}, "invalid_matrix", "matrix"),
        ({"matrix": [[-500.0, 0.0, 320.0], [0.0, -500.0, 240.0], [0.0, 0.0, 1.0]]}, "invalid_matrix", "matrix"),
        ({"matrix": [[500.0, 0.0], [0.0, 500.0]]}, "invalid_matrix", "matrix"),
        ({"matrix": "wide"}, "invalid_matrix", "matrix"),
        ({"rotation": [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]}, "invalid_rotation", "rotation"),
        ({"rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]}, "invalid_rotation", "rotation"),
        ({"translation_m": [0.0, 1e400, 0.0]}, "invalid_translation", "translation"),
        ({"distortion": [0.1, 0.2, 0.3]}, "invalid_distortion", "distortion"),
        ({"size_px": [640, -480]}, "invalid_size", "size"),
    ],
)
def test_each_fault_names_file_camera_and_field(tmp_path: Path, changes: dict[str, Any], code: str, field: str) -> None:
    path = write_own(tmp_path / "cameras.json", [own(**changes)])
    assert problems_of(path) == [(code, "left", field)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"distortion": None}, "The distortion is missing."),
        ({"size_px": 640}, "The size is one number instead of 2 numbers."),
        ({"rotation": [0.1, 0.2, 0.3]}, "The rotation has 3 numbers instead of 3 x 3."),
        ({"translation_m": "far"}, "The translation is not a list of 3 numbers."),
    ],
)
def test_messages_are_true(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        read_calibration(write_own(tmp_path / "cameras.json", [own(**changes)]))
    assert [problem.message for problem in error.value.problems] == [message]


def test_size_that_is_missing_in_benchmark_conversion(tmp_path: Path) -> None:
    path = tmp_path / "shelf.json"
    camera = {"name": "a", "K": own()["matrix"], "R": IDENTITY, "t": [0.0, 0.0, 2.0]}
    path.write_text(json.dumps({"cameras": [camera]}))
    (read,) = read_calibration(path)
    assert (read.name, read.size_px) == ("a", UNKNOWN_SIZE)


_RODRIGUES = "The rotation is neither a matrix of 3 x 3 numbers nor a vector of 3 numbers from -100 to 100 radians."


@pytest.mark.parametrize(
    ("rotation", "message"),
    [
        ("rotation=[0,0,500]", _RODRIGUES),
        ("rotation=[0,0]", _RODRIGUES),
        ("rotation=[0,0,nan]", _RODRIGUES),
        ("rotation='none'", _RODRIGUES),
        ("rotation=[[1,0,0],[0,1,0]]", _RODRIGUES),
        ("rotation=[[1,0,0],[0,1,0],[0,0,2]]", "The rotation is not a rotation: its rows are not orthonormal."),
    ],
)
def test_toml_rotations_that_are_none(tmp_path: Path, rotation: str, message: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f"[a]\nsize=[6,4]\nmatrix=[[5,0,3],[0,5,2],[0,0,1]]\n{rotation}\ntranslation=[0,0,1]\n")
    with pytest.raises(InputError) as error:
        read_calibration(path)
    (problem,) = error.value.problems
    assert (problem.code, problem.camera, problem.field) == ("invalid_rotation", "a", "rotation")
    assert problem.message == message


def test_all_faults_are_said_at_once(tmp_path: Path) -> None:
    path = write_own(
        tmp_path / "cameras.json",
        [own(rotation=[[0.0] * 3] * 3, shutter=1), own(name="right", matrix=[], size_px=[0, 0]), own(name="right")],
    )
    assert sorted(problems_of(path), key=str) == sorted(
        [
            ("invalid_rotation", "left", "rotation"),
            ("invalid_matrix", "right", "matrix"),
            ("invalid_size", "right", "size"),
            ("duplicate_camera", "right", None),
        ],
        key=str,
    )


def test_coefficients_of_telephoto_lens_are_taken(tmp_path: Path) -> None:
    """Lens with a view of 5 degrees: at r = 0.05 from the centre k3 r^6 is 0.009, an ordinary distortion."""
    matrix = [[22_000.0, 0.0, 959.5], [0.0, 22_000.0, 539.5], [0.0, 0.0, 1.0]]
    distortion = [0.5, -300.0, 0.001, -0.002, 6e5]
    path = write_own(tmp_path / "cameras.json", [own(size_px=[1920, 1080], matrix=matrix, distortion=distortion)])
    (camera,) = read_calibration(path)
    ideal_px = np.stack(np.meshgrid(np.linspace(0, 1919, 9), np.linspace(0, 1079, 7)), -1).reshape(-1, 2)
    normalised = (ideal_px - [959.5, 539.5]) / 22_000.0
    points_m = np.column_stack([normalised, np.ones(len(normalised))]) * 40.0 - [0.0, 0.0, 3.0]
    seen_px = project(camera, points_m)
    assert 5 < np.abs(seen_px - ideal_px).max() < 50
    np.testing.assert_allclose(undistort_px(camera, seen_px), ideal_px, atol=1e-6)


@pytest.mark.parametrize("distortion", [[1e9] * 12, [-1e9] * 5])
def test_largest_coefficients_overflow_nowhere(tmp_path: Path, distortion: list[float]) -> None:
    (camera,) = read_calibration(write_own(tmp_path / "cameras.json", [own(distortion=distortion)]))
    points_m = np.array([[0.0, 0.0, 1.0], [100.0, -70.0, -2.9]])
    assert np.isfinite(project(camera, points_m)).all()
    undistort_px(camera, np.array([[0.0, 0.0], [1e6, -1e6], [319.5, 239.5]]))


def test_more_than_any_lens_has_is_refused(tmp_path: Path) -> None:
    path = write_own(tmp_path / "cameras.json", [own(distortion=[0.0, 0.0, 0.0, 0.0, 1e10])])
    assert problems_of(path) == [("invalid_distortion", "left", "distortion")]


@pytest.mark.parametrize("name", ["", "a/b", "..\\up", "line\nbreak", "x" * 100, 7, None])
def test_names_that_could_do_harm(tmp_path: Path, name: Any) -> None:
    assert problems_of(write_own(tmp_path / "cameras.json", [own(name=name)])) == [("invalid_name", "number 1", "name")]


FISHEYE = "[a]\nsize=[6,4]\nmatrix=[[5,0,3],[0,5,2],[0,0,1]]\nrotation=[0,0,0]\ntranslation=[0,0,1]\nfisheye="


def test_fisheye_without_coefficients_has_four_zeros(tmp_path: Path) -> None:
    path = tmp_path / "fisheye.toml"
    path.write_text(FISHEYE + "true\n")
    (camera,) = read_calibration(path)
    assert (camera.lens, camera.distortion.tolist()) == ("fisheye", [0.0] * 4)


def test_wrong_fisheyes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "fisheye.toml"
    path.write_text(FISHEYE + '"yes"\n')
    assert problems_of(path) == [("unsupported_lens", "a", "fisheye")]
    path.write_text(FISHEYE + "true\ndistortions=[1,2,3,4,5]\n")
    assert problems_of(path) == [("invalid_distortion", "a", "distortion")]
    path = write_own(tmp_path / "cameras.json", [own(lens="mei")])
    assert problems_of(path) == [("unsupported_lens", "left", "lens")]


def test_qca_with_missing_numbers(tmp_path: Path) -> None:
    path = tmp_path / "calib.qca.txt"
    camera = '<camera serial="a"><fov_video left="0" right="9" top="0" bottom="9"/><transform r11="x"/></camera>'
    path.write_text(f"<calibration><cameras>{camera}</cameras></calibration>")
    found = problems_of(path)
    assert ("invalid_number", "a", "r11") in found
    assert ("invalid_number", "a", "focalLengthU") in found


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("none.json", None, "calibration_missing"),
        ("cut.json", b'{"cameras": [', "calibration_unreadable"),
        ("list.json", b"[1, 2]", "calibration_unreadable"),
        ("deep.json", b"[" * 100_000, "calibration_unreadable"),
        ("twice.json", b'{"schema_version": 1, "cameras": [], "cameras": []}', "calibration_unreadable"),
        ("cut.yml", b"%YAML:1.0\n---\na: [1", "calibration_unreadable"),
        ("nothing.yml", b"%YAML:1.0\n---\na: 1\n", "calibration_empty"),
        ("nothing.xml", b"<opencv_storage><a>1</a></opencv_storage>", "calibration_empty"),
        ("cut.zip", b"PK\x03\x04", "calibration_unreadable"),
        ("cut.toml", b"[cam", "calibration_unreadable"),
        ("binary.toml", b"\xff\xfe\x00", "calibration_unreadable"),
        ("empty.toml", b"", "calibration_empty"),
        ("bomb.xml", b'<!DOCTYPE x [<!ENTITY a "b">]><calibration>&a;</calibration>', "calibration_unreadable"),
        ("nothing.xml", b"<calibration/>", "calibration_empty"),
        ("video.dat", b"\x00\x00\x00\x18ftyp", "calibration_format"),
    ],
)
def test_files_that_are_no_calibration(tmp_path: Path, name: str, content: bytes | None, code: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert [found for found, _, _ in problems_of(path)] == [code]


def test_200_megabytes_are_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.toml"
    with path.open("wb") as file:
        file.truncate(200 * 2**20)
    assert path.stat().st_size > MAX_BYTES
    assert problems_of(path) == [("calibration_too_large", None, None)]


@pytest.mark.parametrize(("units", "factor"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001)])
def test_units_are_those_that_person_says_where_format_does_not(tmp_path: Path, units: Units, factor: float) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(
        """
[cam_1]
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
distortions = []
rotation = [0.0, 0.0, 0.0]
translation = [500.0, 0.0, 4000.0]
"""
    )
    (camera,) = read_calibration(path, units)
    np.testing.assert_allclose(camera.cam_from_world.translation_m, np.array([500.0, 0.0, 4000.0]) * factor)


def test_axis_that_points_up_becomes_z(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({"schema_version": 1, "cameras": [own()]}))
    (camera,) = read_calibration(path)
    contents = read_contents(path, None, "-y")
    (turned,) = contents.cameras
    x, y, z = center_in_world(camera)
    np.testing.assert_allclose(center_in_world(turned), (x, z, -y), atol=1e-12)
    assert contents.axes == "-Y up, as stated: turned to Z up"


def test_units_of_format_that_says_its_own_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({"schema_version": 1, "cameras": [own()]}))
    assert len(read_calibration(path, "m")) == 1
    with pytest.raises(InputError, match="determines the unit of lengths") as error:
        read_calibration(path, "mm")
    assert [problem.code for problem in error.value.problems] == ["calibration_units"]
