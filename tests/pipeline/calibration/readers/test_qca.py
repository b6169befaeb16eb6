"""Qualisys Track Manager's calibrations: files of versions 2018 to 2025, and parameters of the real-time protocol."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.registry import read_contents
from tests.pipeline.calibration.readers.rigs import problems_of

CAMERA = """<camera active="1" {more} point-count="1916" avg-residual="0.4" serial="{serial}">
<fov_marker left="0" top="0" right="1919" bottom="1079"/><fov_marker_max left="0" top="0" right="1919" bottom="1079"/>
{video}
<transform x="1000" y="-2000" z="1500" r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1"/>
<intrinsic focallength="9.3" sensorMinU="0" sensorMaxU="122880" sensorMinV="0" sensorMaxV="69120"
 focalLengthU="64000" focalLengthV="65280" centerPointU="61440" centerPointV="34560" skew="0"
 radialDistortion1="0.1" radialDistortion2="0" radialDistortion3="0" tangentalDistortion1="0" tangentalDistortion2="0"/>
</camera>"""
WHOLE = (0, 0, 1919, 1079)


def camera(
    serial: str, more: str = 'model="none"', video: tuple[int, int, int, int] | None = WHOLE, skew: str = "0"
) -> str:
    areas = [
        f'<{tag} left="{video[0]}" top="{video[1]}" right="{video[2]}" bottom="{video[3]}"/>'
        for tag in ("fov_video", "fov_video_max")
        if video is not None
    ]
    return CAMERA.format(serial=serial, more=more, video="".join(areas)).replace('skew="0"', f'skew="{skew}"')


def document(*cameras: str) -> str:
    head = '<calibration calibrated="true" source="a.qca" qtm-version="2024.3 (build 14360)" type="regular">'
    return f'{head}<results std-dev="0.4"/><cameras>{"".join(cameras)}</cameras></calibration>'


def read(path: Path, *cameras: str) -> CameraFile:
    path.write_text(document(*cameras))
    return read_contents(path)


def test_principal_point_is_moved_to_filmed_part(tmp_path: Path) -> None:
    contents = read(tmp_path / "calib.qca.txt", camera("whole"), camera("part", video=(480, 240, 1439, 839)))
    assert (contents.format, contents.unit, contents.notes) == ("Qualisys QCA", "mm", ())
    one, other = contents.cameras
    assert (one.size_px, other.size_px) == ((1920, 1080), (960, 600))
    np.testing.assert_allclose(one.matrix, [[1000, 0, 960], [0, 1020, 540], [0, 0, 1]])
    np.testing.assert_allclose(other.matrix, [[1000, 0, 480], [0, 1020, 300], [0, 0, 1]])
    np.testing.assert_allclose(one.cam_from_world.inverse().translation_m, [1.0, -2.0, 1.5])
    np.testing.assert_array_equal(one.distortion, [0.1, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("model", ['model="Miqus Video"', 'model="Arqus A12"', 'model="Miqus Hybrid"', ""])
def test_model_names_hardware(tmp_path: Path, model: str) -> None:
    (one,) = read(tmp_path / "calib.qca.txt", camera("24021", model)).cameras
    assert (one.name, one.matrix[0, 0]) == ("24021", 1000.0)


@pytest.mark.parametrize("video", [None, (0, 0, 0, 0)])
def test_marker_cameras_are_left_out(tmp_path: Path, video: tuple[int, int, int, int] | None) -> None:
    markers = [camera(serial, 'model="Oqus 300"', video) for serial in ("11001", "11002")]
    contents = read(tmp_path / "calib.qca.txt", *markers, camera("24021", 'model="Miqus Video"'))
    assert [rig_camera.name for rig_camera in contents.cameras] == ["24021"]
    assert contents.notes == ("calib.qca.txt: cameras 11001, 11002 are left out: markers, no video.",)


@pytest.mark.parametrize("more", ['calibrated="false"', 'active="0"'])
def test_cameras_that_are_not_calibrated_are_left_out(tmp_path: Path, more: str) -> None:
    idle = camera("24022", more).replace('active="1" active', "active").replace('r11="1"', 'r11="0"')
    contents = read(tmp_path / "calib.qca.txt", camera("24021"), idle)
    assert [rig_camera.name for rig_camera in contents.cameras] == ["24021"]
    assert contents.notes == ("calib.qca.txt: camera 24022 is left out: not calibrated.",)


def test_files_without_camera_that_films_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "calib.qca.txt"
    path.write_text(document(camera("11001", video=None), camera("24021", 'calibrated="false"')))
    assert problems_of(path) == [("calibration_empty", None)]


def test_parameters_of_real_time_protocol(tmp_path: Path) -> None:
    path = tmp_path / "parameters.xml"
    general = "<General><Frequency>100</Frequency><Camera><ID>1</ID></Camera></General>"
    wrapped = f"<QTM_Parameters_Ver_1.25>{general}{document(camera('24021'))}</QTM_Parameters_Ver_1.25>"
    path.write_text(wrapped)
    contents = read_contents(path)
    assert [rig_camera.name for rig_camera in contents.cameras] == ["24021"]
    np.testing.assert_allclose(contents.cameras[0].cam_from_world.inverse().translation_m, [1.0, -2.0, 1.5])


def pose2sim(path: Path, distortion: tuple[float, float], size_px: tuple[int, int] = (1920, 1080)) -> CameraFile:
    """File that Pose2Sim makes of a TOML file: the last pixel's number is the side, the distortion in 64ths."""
    text = document(camera("24021", 'model="none"', (0, 0, *size_px))).replace(
        'source="a.qca"', 'created="sometimes ago"'
    )
    k1, k2 = (str(64 * coefficient) for coefficient in distortion)
    path.write_text(
        text.replace('tion1="0.1"', f'tion1="{k1}"', 1).replace('ialDistortion2="0"', f'ialDistortion2="{k2}"')
    )
    return read_contents(path)


@pytest.mark.parametrize("distortion", [(-0.11, 0.07), (-0.0712345678901, 0.03), (0.0, 1e-3 / 3)])
def test_pose2sim_enlarges_lens_of_its_own_calibrations(tmp_path: Path, distortion: tuple[float, float]) -> None:
    contents = pose2sim(tmp_path / "calib.qca.txt", distortion)
    (one,) = contents.cameras
    assert one.size_px == (1920, 1080)
    np.testing.assert_allclose(one.distortion, [*distortion, 0.0, 0.0, 0.0], rtol=1e-12)
    assert "24021 is stated by Pose2Sim with 64 times the distortion" in contents.notes[1]


def test_pose2sim_keeps_lens_of_qualisys_there_and_back(tmp_path: Path) -> None:
    """Its TOML has a 64th of the distortion, as numbers of Qualisys: -0.046183, 0.139983."""
    contents = pose2sim(tmp_path / "calib.qca.txt", (-0.046183 / 64, 0.139983 / 64), (1087, 1919))
    (one,) = contents.cameras
    assert (one.size_px, one.distortion.tolist()) == ((1088, 1920), [-0.046183, 0.139983, 0.0, 0.0, 0.0])
    assert len(contents.notes) == 1
    assert "the size of the videos is used" in contents.notes[0]


def test_turn_of_views_is_noted(tmp_path: Path) -> None:
    """Qualisys turns the picture in its windows; the video, and so the calibration, is not turned."""
    cameras = camera("24021", 'viewrotation="0"'), camera("24022", 'viewrotation="90"')
    contents = read(tmp_path / "calib.qca.txt", *cameras)
    (note,) = contents.notes
    assert note.startswith("calib.qca.txt: camera 24022 is turned in Qualisys's views")
    assert [rig_camera.size_px for rig_camera in contents.cameras] == [(1920, 1080)] * 2


def test_lenses_with_skew_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "calib.qca.txt"
    path.write_text(document(camera("24021", skew="0.5")))
    assert problems_of(path) == [("unsupported_lens", "24021")]
