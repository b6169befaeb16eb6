"""Program of the web API for calibrations: its answers, and problems with exit code 2."""

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.calibration.on_request import main
from pipeline.calibration.registry import read_contents
from pipeline.calibration.write import encode
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

CAMERAS = build_cameras(Rig(Layout.RING, 2, (3.0, 2.5), 2.0), np.random.default_rng(0))
BOX_M = [[x, y, z] for x in (0.0, 0.8) for y in (0.0, 0.6) for z in (0.3, 1.2)]


@pytest.fixture
def lenses(tmp_path: Path) -> str:
    (tmp_path / "rig.json").write_bytes(encode(CAMERAS))
    return str(tmp_path / "rig.json")


def answer(
    folder: Path, capsys: pytest.CaptureFixture[str], request: dict[str, Any], exit_code: int = 0
) -> dict[str, Any]:
    (folder / "request.json").write_text(json.dumps(request))
    assert main([str(folder / "request.json")]) == exit_code
    printed: dict[str, Any] = json.loads(capsys.readouterr().out)
    return printed


def test_scene_gives_calibration_and_report(tmp_path: Path, lenses: str, capsys: pytest.CaptureFixture[str]) -> None:
    points = [
        [f"P{k}", xyz_m, [[camera.name, *project(camera, np.array(xyz_m)).tolist()] for camera in CAMERAS]]
        for k, xyz_m in enumerate(BOX_M)
    ]
    scene = {"task": "scene", "known_points": points, "sizes_px": {}, "intrinsics": lenses, "up": "z"}
    made = answer(tmp_path, capsys, scene)
    (tmp_path / "made.json").write_text(made["text"])
    for found, truth in zip(read_contents(tmp_path / "made.json").cameras, CAMERAS, strict=True):
        np.testing.assert_allclose(center_in_world(found), center_in_world(truth), atol=1e-6)
    assert len(made["report"]["cameras"][0]["points"]) == 8
    refused = answer(tmp_path, capsys, scene | {"known_points": points[:3]}, 2)
    assert [problem["code"] for problem in refused["problems"]] == ["known_points_few"] * 2


def test_calibration_is_written_for_program(tmp_path: Path, lenses: str, capsys: pytest.CaptureFixture[str]) -> None:
    request = {"task": "file", "calibration": lenses, "to": "easymocap"}
    written = answer(tmp_path, capsys, request)
    (tmp_path / "rig.zip").write_bytes(base64.b64decode(written["content"]))
    found = read_contents(tmp_path / "rig.zip", "m").cameras
    assert [camera.name for camera in found] == [camera.name for camera in CAMERAS]
    np.testing.assert_allclose(found[0].matrix, CAMERAS[0].matrix)
    fisheye = [replace(camera, lens="fisheye", distortion=camera.distortion[:4]) for camera in CAMERAS]
    Path(lenses).write_bytes(encode(fisheye))
    refused = answer(tmp_path, capsys, request, 2)
    assert [problem["code"] for problem in refused["problems"]] == ["unsupported_lens"] * 2


def test_plan_is_of_new_or_stored_cameras(tmp_path: Path, lenses: str, capsys: pytest.CaptureFixture[str]) -> None:
    room = {
        "task": "plan",
        "room_m": [8, 6],
        "cameras": 6,
        "height_m": 2.5,
        "field_deg": 70,
        "size_px": [1920, 1080],
        "people": 1,
    }
    new = answer(tmp_path, capsys, {**room, "calibration": None})
    stored = answer(tmp_path, capsys, {**room, "calibration": lenses})
    assert new["covered"] > stored["covered"]
    assert new["picture"].count("<circle") == 6
    assert stored["picture"].count("<circle") == 2
