"""Qualisys QCA: a part of the sensor is filmed."""

from pathlib import Path

import numpy as np

from pipeline.calibration.registry import read_contents

CAMERA = """<camera serial="{serial}" model="none">
<fov_video left="{left}" top="{top}" right="{right}" bottom="{bottom}"/>
<transform x="1000" y="-2000" z="1500" r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1"/>
<intrinsic focalLengthU="64000" focalLengthV="65280" centerPointU="61440" centerPointV="34560" skew="0"
 radialDistortion1="0.1" radialDistortion2="0" radialDistortion3="0" tangentalDistortion1="0" tangentalDistortion2="0"/>
</camera>"""


def test_the_principal_point_is_moved_to_the_filmed_part(tmp_path: Path) -> None:
    path = tmp_path / "calib.qca.txt"
    whole = CAMERA.format(serial="whole", left=0, top=0, right=1919, bottom=1079)
    part = CAMERA.format(serial="part", left=480, top=240, right=1439, bottom=839)
    path.write_text(f"<calibration><cameras>{whole}{part}</cameras></calibration>")
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("Qualisys QCA", "mm")
    one, other = contents.cameras
    assert (one.size_px, other.size_px) == ((1920, 1080), (960, 600))
    np.testing.assert_allclose(one.matrix, [[1000, 0, 960], [0, 1020, 540], [0, 0, 1]])
    np.testing.assert_allclose(other.matrix, [[1000, 0, 480], [0, 1020, 300], [0, 0, 1]])
    np.testing.assert_allclose(one.cam_from_world.inverse().translation_m, [1.0, -2.0, 1.5])
