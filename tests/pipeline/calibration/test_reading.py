"""Cameras that can't serve are left out by name; what decides about the others is checked."""

from typing import Any

import numpy as np
import pytest

from pipeline.calibration.camera_names import name_problem
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import RawCamera
from pipeline.core.errors import InputError

MATRIX = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]


def raw(name: str, **changes: Any) -> RawCamera:
    values: dict[str, Any] = {
        "size_px": [640, 480],
        "matrix": MATRIX,
        "distortion": [],
        "rotation": np.eye(3),
        "translation_m": [0.0, 0.0, 4000.0],
    }
    return RawCamera(name, **(values | changes))


def test_cameras_without_pose_or_matrix_are_left_out() -> None:
    cameras = [raw("a"), raw("b", rotation=None), raw("c", matrix=None), raw("d", translation_m=None), raw("e")]
    contents = Reading("rig.toml").contents("TOML", cameras, "mm")
    assert [camera.name for camera in contents.cameras] == ["a", "e"]
    assert contents.notes == (
        "rig.toml: camera c is left out: no camera matrix in the file.",
        "rig.toml: cameras b, d are left out: no pose in the file.",
    )
    np.testing.assert_array_equal(contents.cameras[0].cam_from_world.translation_m, [0.0, 0.0, 4.0])
    assert [camera.name for camera in contents.unposed] == ["b", "d"]
    np.testing.assert_array_equal(contents.unposed[0].cam_from_world.translation_m, np.zeros(3))


def test_faults_of_cameras_that_are_left_out_do_not_count() -> None:
    contents = Reading("rig.toml").contents("TOML", [raw("a"), raw("b", rotation=None, size_px=[0, 0])], "m")
    assert [camera.name for camera in contents.cameras] == ["a"]
    assert contents.unposed == ()


def test_intrinsics_alone() -> None:
    contents = Reading("intri.yml").contents("OpenCV", [raw("a", rotation=None, translation_m=None)], None)
    assert contents.cameras == ()
    assert [camera.name for camera in contents.unposed] == ["a"]
    assert contents.notes == ()


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"matrix": [[500.0]]}, "invalid_matrix"),
        ({"rotation": np.zeros((3, 3))}, "invalid_rotation"),
        ({"translation_m": [0.0, 0.0, np.nan]}, "invalid_translation"),
        ({"distortion": [1e10] * 5}, "invalid_distortion"),
    ],
)
def test_each_camera_is_checked_in_full(changes: dict[str, Any], code: str) -> None:
    with pytest.raises(InputError) as error:
        Reading("rig.toml").contents("TOML", [raw("a"), raw("b", **changes)], "m")
    assert [(problem.code, problem.camera) for problem in error.value.problems] == [(code, "b")]


def test_notes_are_short_whatever_file_names() -> None:
    reading = Reading("rig.toml")
    reading.pass_over({f"field \0{k:050d}": k for k in range(10_000)}, frozenset())
    reading.leave_out([f"camera {k}" for k in range(10_000)], "markers, no video")
    contents = reading.contents("TOML", [raw("a")], "m")
    assert all(len(note) < 500 and note.isprintable() for note in contents.notes)
    assert "and 9,992 more" in contents.notes[0]


@pytest.mark.parametrize("name", [".", "..", "a/b", "a\\b", "a\nb", "", "x" * 1000])
def test_names_that_are_no_names_of_folders_are_refused(name: str) -> None:
    assert name_problem(name)


@pytest.mark.parametrize("name", ["cam 1", "...", "$(reboot)", "`id`;'\"", "-rf", "[red]cam", "ñ"])
def test_names_that_shell_would_read_are_allowed(name: str) -> None:
    assert name_problem(name) is None
