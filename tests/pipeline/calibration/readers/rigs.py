"""A rig of two cameras, and the comparison of what a reader finds with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError
from pipeline.core.options.job_choices import Units
from pipeline.geometry.camera import project

POINTS_M = np.array([[0.0, 0.0, 1.0], [0.5, -0.3, 1.7], [-0.4, 0.6, 0.2]])


def camera(name: str, turn: float, distortion: tuple[float, ...] = (-0.11, 0.07, 0.002, -0.003, 0.01)) -> Camera:
    """Camera at 4 m, at a height of about 1.5 m, that looks at the points."""
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    rotation = (
        Rotation.from_rotvec([0.1, 0.03, -0.05]).as_matrix() @ upright @ Rotation.from_euler("z", turn).as_matrix()
    )
    matrix = np.array([[1450.0, 0.0, 951.5], [0.0, 1460.0, 548.25], [0.0, 0.0, 1.0]])
    return Camera(name, (1920, 1080), matrix, np.array(distortion), Rigid3(rotation, np.array([0.1, 1.2, 4.2])))


def fisheye(name: str, turn: float, distortion: tuple[float, ...] = (0.035, -0.011, 0.002, -0.0005)) -> Camera:
    """The same camera with a fisheye lens."""
    return replace(camera(name, turn, distortion), lens="fisheye")


RIG = (camera("left", 0.3), camera("right", -0.8))


def assert_rig(contents: CameraFile, rig: tuple[Camera, ...] = RIG, num_digits: int = 5) -> None:
    """Compare names, sizes and projections of points in metres."""
    assert [found.name for found in contents.cameras] == [expected.name for expected in rig]
    for found, expected in zip(contents.cameras, rig, strict=True):
        assert (found.size_px, found.lens) == (expected.size_px, expected.lens)
        seen_px = project(expected, POINTS_M)
        assert np.isfinite(seen_px).all()
        np.testing.assert_allclose(project(found, POINTS_M), seen_px, atol=10.0**-num_digits)


def problems_of(path: Path, units: Units | None = "m") -> list[tuple[str, str | None]]:
    """Codes and cameras of the problems of a file."""
    with pytest.raises(InputError) as error:
        read_contents(path, units)
    assert all(problem.file == path.name for problem in error.value.problems)
    return [(problem.code, problem.camera) for problem in error.value.problems]
