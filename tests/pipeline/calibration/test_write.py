"""Files that are written are read as the same cameras, also by the programs whose formats they are."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.calibration.registry import read_contents
from pipeline.calibration.write import ENCODERS
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, camera, fisheye


@pytest.mark.parametrize("ending", ENCODERS)
def test_what_is_written_is_read(tmp_path: Path, ending: str) -> None:
    rig = (*RIG, camera('Kamera "1" é: #', 0.5, ()), camera("01", 1.0, tuple(0.01 * np.arange(12))), fisheye("f", 2.0))
    path = tmp_path / f"rig{ending}"
    path.write_bytes(ENCODERS[ending](rig))
    assert_rig(read_contents(path), rig, num_digits=9)


def test_opencv_reads_its_yaml(tmp_path: Path) -> None:
    path = tmp_path / "rig.yml"
    path.write_bytes(ENCODERS[".yml"](RIG))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    node = storage.getNode("right")
    np.testing.assert_array_equal(node.getNode("camera_matrix").mat(), RIG[1].matrix)
    np.testing.assert_array_equal(node.getNode("tvec").mat().ravel(), RIG[1].cam_from_world.translation_m)
    np.testing.assert_allclose(cv2.Rodrigues(node.getNode("rvec").mat())[0], RIG[1].cam_from_world.rotation, atol=1e-12)
    assert int(node.getNode("image_width").real()) == 1920
    storage.release()
