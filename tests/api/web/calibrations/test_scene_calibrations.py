"""Calibrations of a scene: made at once from known points, with each point's error; wrong points are named."""

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from api.web.settings import Settings
from pipeline.calibration.write import encode
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from tests.api.conftest import Live, problem_of, running
from tests.warm_programs import WarmPrograms

CAMERAS = build_cameras(Rig(Layout.RING, 2, (3.0, 2.5), 2.0), np.random.default_rng(0))
CORNERS_M = [(x, y, z + 0.2 * x) for x in (0.0, 0.8) for y in (0.0, 0.6) for z in (0.3, 1.2)]
SIZES = {camera.name: list(camera.size_px) for camera in CAMERAS}


@pytest.fixture(scope="module")
def strict(make_settings: Callable[..., Settings], warm_programs: WarmPrograms) -> Iterator[Live]:
    """Running service with the real check of files."""
    command = warm_programs.command("pipeline.capture.preflight")
    with running(make_settings(preflight_command=command, preflight_timeout_s=120.0, max_json_bytes=100_000)) as live:
        yield live


def marked() -> list[dict[str, Any]]:
    """Corners of two boxes, as the cameras see them."""
    return [
        {"name": f"P{k}", "xyz_m": xyz_m, "seen_px": {c.name: project(c, np.array(xyz_m)).tolist() for c in CAMERAS}}
        for k, xyz_m in enumerate(CORNERS_M)
    ]


def send(live: Live, intrinsics: bytes | None = None, **spec: Any) -> Any:
    body = json.dumps({"method": "scene", **spec}).encode()
    parts: list[tuple[str, Any]] = [("spec", (None, body))]
    if intrinsics is not None:
        parts.append(("intrinsics", ("lenses.json", intrinsics)))
    return live.client.post("/v1/calibrations", files=parts)


def test_scene_makes_calibration_at_once(strict: Live) -> None:
    answer = send(strict, encode(CAMERAS), known_points=marked(), name="Hall")
    assert answer.status_code == 201, answer.text
    made = answer.json()
    assert (made["method"], made["state"], made["name"], made["urls"]["job"]) == ("scene", "ready", "Hall", None)
    for camera, truth in zip(made["cameras"], CAMERAS, strict=True):
        assert camera["position_m"] == pytest.approx(center_in_world(truth), abs=1e-5)
    assert [point["name"] for point in made["report"]["cameras"][1]["points"]] == [f"P{k}" for k in range(8)]
    assert made["source"]["known_points"][7]["name"] == "P7"
    path = made["urls"]["self"]
    assert strict.client.get(path).json() == made
    assert strict.client.get(made["urls"]["file"]).json()["cameras"][0]["name"] == "cam_00"
    assert strict.client.delete(path).status_code == 204
    problem_of(strict.client.get(path), 404, "not_found")


def test_scene_without_lenses_and_files_is_sent_as_json(strict: Live) -> None:
    body = {"method": "scene", "known_points": marked(), "sizes_px": SIZES}
    answer = strict.client.post("/v1/calibrations", json=body)
    assert answer.status_code == 201, answer.text
    made = answer.json()
    assert made["name"] == "scene, 8 points"
    assert "Lenses are estimated" in made["report"]["world"]
    assert made["cameras"][0]["position_m"] == pytest.approx(center_in_world(CAMERAS[0]), abs=0.15)


def errors_of(answer: Any) -> list[dict[str, Any]]:
    errors: list[dict[str, Any]] = problem_of(answer, 422, "invalid_request")["errors"]
    return errors


def test_all_problems_of_scene_come_at_once(strict: Live) -> None:
    points = marked()
    points[2]["seen_px"]["cam_00"][0] += 60
    (error,) = errors_of(send(strict, encode(CAMERAS), known_points=points))
    assert (error["code"], error["pointer"], error["camera"]) == ("known_points_misfit", "/spec/known_points", "cam_00")
    assert "P2 is 60 px off; without it the error is 0.0 px." in error["message"]
    few = errors_of(send(strict, known_points=points[:5], sizes_px=SIZES))
    assert [(error["code"], error["camera"]) for error in few] == [
        ("known_points_few", "cam_00"),
        ("known_points_few", "cam_01"),
    ]
    unsized = errors_of(send(strict, known_points=points))
    assert [(error["code"], error["pointer"]) for error in unsized] == [("invalid_size", "/spec/sizes_px")] * 2
    (missing,) = errors_of(send(strict, sizes_px=SIZES))
    assert (missing["code"], missing["pointer"]) == ("missing_part", "/spec/known_points")
    (useless,) = errors_of(send(strict, known_points=points, stature_m=[1.7]))
    assert (useless["code"], useless["pointer"]) == ("part_not_allowed", "/spec/stature_m")
    named = [points[0] | {"seen_px": {"a/b": [1, 1]}}]
    (nameless,) = errors_of(send(strict, known_points=named, sizes_px={"a/b": [10, 10]}))
    assert (nameless["code"], nameless["pointer"]) == ("invalid_name", "/spec/known_points")
