"""Motive's MCAL, in the form that Motive 3.4 writes: UTF-16, y up, cameras that look along -z."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, problems_of

MOTIVE_FROM_UPRIGHT = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def element(one: Camera, imager: str = "30") -> str:
    x, y, z = (MOTIVE_FROM_UPRIGHT @ center_in_world(one)).tolist()
    upright_from_cam = one.cam_from_world.rotation.T @ np.diag([1, -1, -1])
    turned = (MOTIVE_FROM_UPRIGHT @ upright_from_cam).ravel().tolist()
    orientation = " ".join(f'OrientMatrix{k}="{value!r}"' for k, value in enumerate(turned))
    k1, k2, p1, p2, k3 = one.distortion.tolist()
    (fx, _, cx), (_, fy, cy), _ = one.matrix.tolist()
    centre = f'LensCenterX="{cx}" LensCenterY="{cy}" HorizontalFocalLength="{fx}" VerticalFocalLength="{fy}"'
    return f"""<Camera Serial="{one.name}">
<Properties CameraID="6" ImagerIndex="{imager}" Exposure="250" VideoType="6" Orientation="0.000000000000000"/>
<Attributes Revision="50" ImagerPixelWidth="{one.size_px[0]}" ImagerPixelHeight="{one.size_px[1]}"/>
<Intrinsic {centre} k1="0.9" k2="0.9" k3="0.9" TangentialX="0.9" TangentialY="0.9"/>
<IntrinsicStandardCameraModel {centre} k1="{k1}" k2="{k2}" k3="{k3}" TangentialX="{p1}" TangentialY="{p2}"/>
<Extrinsic X="{x!r}" Y="{y!r}" Z="{z!r}" {orientation}/>
<CameraSoftwareFilters FilterLevel="2"/><CameraHardwareFilters GrayscaleFloor="48"/>
<Calibration PartitionID="1"/><ColorCamera CameraResolution="0"/>
</Camera>
"""


def document(*elements: str) -> str:
    return f"""<?xml version="1.0" encoding="UTF-16LE"?>
<calibrationProfile version="1">
<MotiveBuildInfo AppVersion="3.4.0.2" BuildStamp="build" BuildDate="March 16, 2026"/>
<Calibration><Cameras Count="{len(elements)}">{"".join(elements)}</Cameras>
<CalibrationAttributes><TriangulationMeanResidual Error="0.001"/></CalibrationAttributes></Calibration>
<property_warehouse/><MaskData/>
</calibrationProfile>
"""


@pytest.mark.parametrize("mark", [b"", b"\xff\xfe"])
def test_colour_cameras_are_read(tmp_path: Path, mark: bytes) -> None:
    path = tmp_path / "System Calibration.mcal"
    tracking = element(RIG[0], imager="00").replace("left", "M123456")
    path.write_bytes(mark + document(tracking, *map(element, RIG)).encode("utf-16-le"))
    contents = read_contents(path)
    assert (contents.format, contents.unit, contents.axes) == ("OptiTrack", "m", "y up, turned to Z up")
    assert contents.notes == ("System Calibration.mcal: camera M123456 is left out: markers, no video.",)
    assert_rig(contents)


def test_all_cameras_are_read_if_none_films_in_colour(tmp_path: Path) -> None:
    path = tmp_path / "rig.xml"
    path.write_text(document(*(element(one, imager="00") for one in RIG)).replace("UTF-16LE", "UTF-8"))
    contents = read_contents(path)
    assert contents.notes == ()
    assert_rig(contents)


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("<Extrinsic", "<Removed", "invalid_number"),
        ('Serial="left"', "", "invalid_name"),
        ('ImagerPixelWidth="1920"', 'ImagerPixelWidth="x"', "invalid_number"),
        ('k1="-0.11"', 'k1="1e300"', "invalid_number"),
        ('OrientMatrix0="', 'OrientMatrix0="5', "invalid_rotation"),
        ("</calibrationProfile>", "", "calibration_unreadable"),
    ],
)
def test_wrong_values_are_reported(tmp_path: Path, old: str, new: str, code: str) -> None:
    path = tmp_path / "rig.mcal"
    path.write_bytes(document(element(RIG[0]).replace(old, new)).replace(old, new).encode("utf-16-le"))
    assert code in {found for found, _ in problems_of(path)}
