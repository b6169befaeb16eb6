"""Commands ``multicap calibration show``, ``check`` and ``convert``."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.calibration.contents import scaled
from pipeline.calibration.registry import read_contents
from pipeline.calibration.vertical import AXES, turn_upright
from pipeline.calibration.write import encode, encode_opencv
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig
from tests.pipeline.simulations import write_simulation

runner = CliRunner()


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yml"
    path.write_bytes(encode_opencv(RIG))
    return path


def test_show(rig: Path) -> None:
    result = runner.invoke(app, ["calibration", "show", str(rig)])
    assert result.exit_code == 0
    assert "OpenCV; lengths in the file: m, as neither the format nor --units states" in result.stderr
    assert [line.split()[0] for line in result.stdout.splitlines()] == ["camera", "left", "right"]
    assert "1920 x 1080" in result.stdout


def test_show_as_json(rig: Path) -> None:
    found = json.loads(runner.invoke(app, ["calibration", "show", str(rig), "--units=mm", "--json"]).stdout)
    assert (found["format"], found["units"]) == ("OpenCV", "mm")
    left = found["cameras"][0]
    assert (left["name"], left["size_px"]) == ("left", [1920, 1080])
    np.testing.assert_allclose(left["translation_m"], RIG[0].cam_from_world.translation_m / 1000)


@pytest.mark.parametrize("ending", [".json", ".toml", ".yml", ".YAML"])
def test_convert(rig: Path, ending: str) -> None:
    target = rig.with_name(f"converted{ending}")
    result = runner.invoke(app, ["calibration", "convert", str(rig), str(target)])
    assert result.exit_code == 0
    assert_rig(read_contents(target), num_digits=9)


@pytest.mark.parametrize(
    ("target", "to"),
    [
        ("rig.qca.txt", None),
        ("rig.xml", "qca"),
        ("rig.zip", "colmap"),
        ("rig.zip", "opencap"),
        ("rig.toml", "freemocap"),
    ],
)
def test_convert_writes_for_other_programs(rig: Path, target: str, to: str | None) -> None:
    words = [] if to is None else [f"--to={to}"]
    result = runner.invoke(app, ["calibration", "convert", str(rig), str(rig.with_name(target)), *words])
    assert result.exit_code == 0
    assert_rig(read_contents(rig.with_name(target)), num_digits=6)


@pytest.mark.parametrize(
    ("target", "to", "code", "told"),
    [
        ("rig.zip", None, "calibration_format", "State one by --to: opencap, easymocap, colmap"),
        ("rig.json", "qca", "calibration_format", "Use .qca.txt or .qca or .xml."),
        ("rig.json", "vicon", "calibration_format", "There is no format 'vicon'. State one by --to: multicap"),
        ("rig.yaml", "mamma", "unsupported_lens", "MAMMA's YAML can't hold 5 coefficients of distortion, but 4."),
    ],
)
def test_convert_refuses_in_a_sentence(rig: Path, target: str, to: str | None, code: str, told: str) -> None:
    words = [] if to is None else [f"--to={to}"]
    result = runner.invoke(app, ["calibration", "convert", str(rig), str(rig.with_name(target)), *words, "--json"])
    problems = json.loads(result.stdout)["problems"]
    assert (result.exit_code, {problem["code"] for problem in problems}) == (2, {code})
    assert told in f"{problems[0]['message']} {problems[0]['hint']}"
    assert not rig.with_name(target).exists()


@pytest.mark.parametrize("up", ["y", "-y", "-z", "x"])
def test_convert_turns_world_upright(tmp_path: Path, up: str) -> None:
    """Cameras above a floor whose axis is another one; the check names this axis."""
    rig = build_cameras(Rig(Layout.RING, 4, (4.0, 3.0), 2.2), np.random.default_rng(1))
    other_from_upright = turn_upright(AXES[up]).T
    source, target = tmp_path / "other.json", tmp_path / "upright.json"
    source.write_bytes(encode([in_world(camera, other_from_upright) for camera in rig]))
    finding = check(str(source))[1]["findings"][0]
    assert (finding["evidence"]["up_axis"], finding["code"]) == (up, "upside_down" if up == "-z" else "not_upright")
    assert f"--up={up}" in finding["hint"]
    assert check(str(source), f"--up={up}")[1]["findings"] == []
    assert runner.invoke(app, ["calibration", "convert", str(source), str(target), f"--up={up}"]).exit_code == 0
    for found, camera in zip(read_contents(target).cameras, rig, strict=True):
        np.testing.assert_allclose(center_in_world(found), center_in_world(camera), atol=1e-9)
        np.testing.assert_allclose(found.cam_from_world.rotation, camera.cam_from_world.rotation, atol=1e-9)


def in_world(camera: Camera, other_from_world: np.ndarray) -> Camera:
    pose = camera.cam_from_world
    return replace(camera, cam_from_world=Rigid3(pose.rotation @ other_from_world.T, pose.translation_m))


def test_convert_unsupported_is_refused(tmp_path: Path, rig: Path) -> None:
    def problems(*words: str) -> list[str]:
        result = runner.invoke(app, ["calibration", *words, "--json"])
        assert result.exit_code in {1, 2}
        return [problem["code"] for problem in json.loads(result.stdout)["problems"]]

    assert problems("show", str(tmp_path / "none.json")) == ["calibration_missing"]
    assert problems("show", str(rig), "--units=feet") == ["unknown_units"]
    assert problems("convert", str(rig), str(tmp_path / "rig.doc")) == ["calibration_format"]
    assert problems("convert", str(rig), str(tmp_path / "rig.json"), "--up=w") == ["unknown_axis"]
    assert problems("convert", str(rig), str(tmp_path / "nowhere" / "rig.json")) == ["pipeline_error"]
    unsized = tmp_path / "unsized.yml"
    unsized.write_text("\n".join(line for line in rig.read_text().splitlines() if "image_" not in line))
    assert problems("convert", str(unsized), str(tmp_path / "rig.json")) == ["invalid_size", "invalid_size"]
    assert not (tmp_path / "rig.json").exists()
    own = tmp_path / "own.json"
    own.write_bytes(encode(RIG))
    assert problems("show", str(own), "--units=mm") == ["calibration_units"]
    in_mm = tmp_path / "in_mm.yml"
    in_mm.write_bytes(encode_opencv([scaled(camera, 1000.0) for camera in RIG]))
    assert problems("show", str(in_mm)) == ["calibration_units_unstated"]


def test_convert_takes_sizes_that_file_does_not_contain(tmp_path: Path, rig: Path) -> None:
    unsized, target = tmp_path / "unsized.yml", tmp_path / "sized.json"
    unsized.write_text("\n".join(line for line in rig.read_text().splitlines() if "image_" not in line))

    def convert(source: Path, *sizes: str) -> Any:
        options = [f"--size={size}" for size in sizes]
        result = runner.invoke(app, ["calibration", "convert", str(source), str(target), "--json", *options])
        return json.loads(result.stdout)

    hints = [problem["hint"] for problem in convert(unsized, "left=1280x720")["problems"]]
    assert len(hints) == 1
    assert "--size" in hints[0]
    assert not target.exists()
    convert(unsized, "1280x720", "right=1920X1080")
    assert [camera.size_px for camera in read_contents(target).cameras] == [(1280, 720), (1920, 1080)]
    wrong = convert(unsized, "1280", "0x720", "third=1280x720", "1280x720")["problems"]
    assert [problem["code"] for problem in wrong] == ["parameter_unreadable", "parameter_unreadable", "camera_unknown"]
    stated = convert(rig, "1920x1080", "left=1280x720")["problems"]
    assert [(problem["code"], problem["camera"]) for problem in stated] == [("invalid_size", "left")]


def test_calibration_unit_unstated_is_asked_for(tmp_path: Path) -> None:
    in_mm = tmp_path / "in_mm.yml"
    in_mm.write_bytes(encode_opencv([scaled(camera, 1000.0) for camera in RIG]))
    code, found = check(str(in_mm))
    assert (code, [finding["code"] for finding in found["findings"]]) == (2, ["calibration_units_unstated"])
    assert check(str(in_mm), "--units=mm")[0] == 0


def test_cameras_that_are_left_out_are_named(tmp_path: Path, rig: Path) -> None:
    text = rig.read_text()
    rig.write_text(text + "third:\n" + text.partition("left:\n")[2].partition("right:")[0].replace("rvec", "turn"))
    code, found = check(str(rig))
    (note, unread) = (finding["message"] for finding in found["findings"])
    assert (code, note) == (0, f"{rig.name}: camera third is left out: no pose in the file.")
    assert unread == f"{rig.name}: fields that are not read: turn."


def check(*words: str) -> tuple[int, dict[str, Any]]:
    result = runner.invoke(app, ["calibration", "check", *words, "--json"])
    return result.exit_code, json.loads(result.stdout)


def test_check_of_good_calibration(rig: Path) -> None:
    code, found = check(str(rig))
    assert (code, found["findings"]) == (0, [])
    assert [camera["name"] for camera in found["cameras"]] == ["left", "right"]
    result = runner.invoke(app, ["calibration", "check", str(rig)])
    assert "2 cameras: nothing is wrong with the calibration." in result.stderr


def test_check_names_unit_and_camera(tmp_path: Path) -> None:
    far = tmp_path / "far.json"
    poses = (Rigid3(one.cam_from_world.rotation, -1e4 * np.eye(3)[axis]) for axis, one in enumerate(RIG))
    far.write_bytes(encode([replace(one, cam_from_world=pose) for one, pose in zip(RIG, poses, strict=True)]))
    code, found = check(str(far))
    assert code == 2
    assert [(one["code"], one["severity"]) for one in found["findings"]] == [("world_unit", "error")]
    result = runner.invoke(app, ["calibration", "check", str(far)])
    assert (result.exit_code, "error The cameras are up to" in result.stderr) == (2, True)


def test_check_of_file_that_cannot_be_read(tmp_path: Path) -> None:
    code, found = check(str(tmp_path / "none.json"))
    assert (code, found["cameras"]) == (2, [])
    assert [(one["code"], one["severity"], one["camera"]) for one in found["findings"]] == [
        ("calibration_missing", "error", None)
    ]
    assert check(str(tmp_path / "none.json"), "--timestamps=t.csv")[1]["problems"][0]["code"] == "sources"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five seconds of two people in a room."""
    scene = replace(find_scene("room"), duration_s=5.0)
    folder = tmp_path_factory.mktemp("room")
    write_simulation(record(scene, seed=3, num_views=4), folder)
    return folder


@pytest.mark.slow
def test_people_tell_turned_camera_and_wrong_floor(room: Path) -> None:
    """Calibrations that are good by themselves are compared with people."""
    cameras = read_contents(room / "calibration.json").cameras
    people = ("--keypoints", str(room / "keypoints"), "--timestamps", str(room / "timestamps.csv"))
    code, found = check(str(room / "calibration.json"), *people)
    assert (code, found["findings"]) == (0, [])

    def findings(name: str, changed: Sequence[Camera]) -> list[dict[str, Any]]:
        file = room / name
        file.write_bytes(encode(changed))
        assert check(str(file))[1]["findings"] == []
        code, found = check(str(file), *people)
        assert code == 0
        listed: list[dict[str, Any]] = found["findings"]
        return listed

    turn = np.array([0.0, np.radians(1.5), 0.0, 0.0, 0.0, 0.0, 0.0])
    (turned,) = findings("turned.json", [move_camera(cameras[0], turn), *cameras[1:]])
    assert (turned["code"], turned["camera"]) == ("camera_disagrees", cameras[0].name)
    lift_m = np.array([0.0, 0.0, 0.5])
    lifted = [replace(one, cam_from_world=one.cam_from_world @ Rigid3(np.eye(3), -lift_m)) for one in cameras]
    (high,) = findings("lifted.json", lifted)
    assert (high["code"], high["evidence"]) == ("floor_not_at_zero", {"height_m": pytest.approx(0.5, abs=0.05)})


def test_plan_states_coverage_and_draws_picture(tmp_path: Path, rig: Path) -> None:
    picture = tmp_path / "plan.svg"
    words = ["calibration", "plan", "--room=8x6", "--json"]
    result = runner.invoke(app, [*words, "--cameras=6", "--people=3", f"--out={picture}"])
    found = json.loads(result.stdout)
    assert (result.exit_code, len(found["places"]), len(found["cameras"])) == (0, 9, 6)
    assert 0.5 < found["covered"] < 1.0
    middle = found["places"][4]
    assert middle["views"] > 5
    assert 5 < middle["error_mm"] < 30
    assert picture.read_text().startswith("<svg")
    stand = json.loads(runner.invoke(app, [*words, f"--calibration={rig}"]).stdout)
    assert [camera["name"] for camera in stand["cameras"]] == ["left", "right"]


def test_plan_refuses_all_wrong_options_at_once() -> None:
    words = ["--room=8", "--cameras=1", "--height=0", "--fov=175", "--size=big", "--people=0", "--json"]
    result = runner.invoke(app, ["calibration", "plan", *words])
    problems = json.loads(result.stdout)["problems"]
    assert (result.exit_code, len(problems)) == (2, 6)
    assert "--room must be 1 to 100 m." in [problem["message"] for problem in problems]
