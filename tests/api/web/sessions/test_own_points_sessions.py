"""Rigid objects and bones of own points: a part of sessions, by the real check, and an option of commands."""

import csv
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.calibration.write import encode
from tests.api.conftest import Live, problem_of
from tests.api.web.sessions.test_keypoint_programs import checking  # noqa: F401 - fixture
from tests.pipeline.own_point_scenes import BOX, RACKET, OwnScene, rigid_scene

OBJECTS = {"objects": {"racket": {"points": RACKET}, "box": {"points": BOX}}, "bones": [["grip", "tip"]]}


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    """Files of a session by their paths: annotations of COCO whose category names all points, and the clock."""
    return own_files(rigid_scene(duration_s=0.6, num_views=3))


def own_files(scene: OwnScene) -> dict[str, bytes]:
    session, found = scene.session, dict[str, bytes]()
    times = ["camera,frame,time_s"]
    for camera in session.cameras:
        bodies, own = session.detections[camera.name], session.own
        joints = np.concatenate([bodies.keypoints_px, own.of_bodies[camera.name].keypoints_px], axis=1)
        alone = own.of_scene[camera.name]
        nothing = np.full((len(alone.frame), len(session.joints.names), 2), np.nan)
        rows = [
            *zip(bodies.frame.tolist(), joints, strict=True),
            *zip(alone.frame.tolist(), np.concatenate([nothing, alone.keypoints_px], axis=1), strict=True),
        ]
        names = [*session.joints.names, *own.names]
        frames = range(len(session.times[camera.name].time_s))
        document = {
            "images": [
                {"id": frame, "file_name": f"{frame:06d}.png", "width": 1280, "height": 720} for frame in frames
            ],
            "categories": [{"id": 1, "name": "person", "keypoints": names}],
            "annotations": [
                {"id": k, "image_id": frame, "category_id": 1, "keypoints": listed(row_px)}
                for k, (frame, row_px) in enumerate(rows)
            ],
        }
        found[f"keypoints/{camera.name}/annotations.json"] = json.dumps(document).encode()
        times += [
            f"{camera.name},{frame},{time_s:.6f}" for frame, time_s in enumerate(session.times[camera.name].time_s)
        ]
    return found | {"timestamps.csv": "\n".join(times).encode(), "calibration.json": encode(session.cameras)}


def listed(row_px: np.ndarray) -> list[float]:
    known = np.isfinite(row_px).all(-1)
    numbers: list[float] = np.column_stack([np.where(known[:, None], row_px, 0.0), 2.0 * known]).ravel().tolist()
    return numbers


def sent(files: dict[str, bytes], own: bytes) -> list[tuple[str, Any]]:
    parts: list[tuple[str, Any]] = [("own_points", ("own.yaml", own))]
    for path, content in files.items():
        if path.startswith("keypoints/"):
            archive = io.BytesIO()
            with zipfile.ZipFile(archive, "w") as entries:
                entries.writestr("annotations.json", content)
            parts.append(("keypoints", (f"{path.split('/')[1]}.zip", archive.getvalue())))
        else:
            parts.append((Path(path).stem, (path, content)))
    return parts


def test_session_has_objects(checking: Live, files: dict[str, bytes]) -> None:  # noqa: F811
    parts = sent(files, json.dumps(OBJECTS).encode())
    session = checking.client.post("/v1/sessions", files=parts).raise_for_status().json()
    assert {file["name"]: file["kind"] for file in session["files"]}["own.yaml"] == "own_points"
    findings = session["preflight"]["findings"]
    (told,) = [finding for finding in findings if finding["message"].startswith("own.yaml has ")]
    assert told["message"] == (
        "own.yaml has racket of tip, left, right, grip; box of box_a, box_b, box_c, box_d; 1 bones."
    )
    # A copy of the session has the file, unless another one is sent.
    rig = next(content for name, content in parts if name == "calibration")
    spec = ("spec", (None, json.dumps({"method": "file"})))
    stored = checking.client.post("/v1/calibrations", files=[("calibration", rig), spec]).raise_for_status().json()
    copied = {"session_id": session["id"], "calibration_id": stored["id"]}
    copy = checking.client.post("/v1/sessions", json=copied).raise_for_status().json()
    assert told in copy["preflight"]["findings"]


def test_problems_of_the_file_point_to_it(checking: Live, files: dict[str, bytes]) -> None:  # noqa: F811
    wrong = b"objects: {box: {distances: [[box_a, box_b, 1], [box_b, hoof, 1]]}}"
    answer = checking.client.post("/v1/sessions", files=sent(files, wrong))
    problems = problem_of(answer, 422, "invalid_request")["errors"]
    assert [problem["code"] for problem in problems] == ["own_points_invalid"] * 2
    assert [problem["pointer"] for problem in problems] == ["/own_points"] * 2


def test_file_without_keypoints_is_refused(checking: Live) -> None:  # noqa: F811
    parts = [
        ("own_points", ("own.yaml", b"bones: []")),
        ("videos", ("cam_0.mp4", b"")),
        ("calibration", ("c.json", b"")),
    ]
    problems = problem_of(checking.client.post("/v1/sessions", files=parts), 422, "invalid_request")["errors"]
    assert ("part_not_allowed", "/own_points") in {(problem["code"], problem["pointer"]) for problem in problems}


def test_command_writes_poses(files: dict[str, bytes], tmp_path: Path) -> None:
    for path, content in {**files, "own.yaml": json.dumps(OBJECTS).encode()}.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    sources = ["--keypoints", str(tmp_path / "keypoints"), "--calibration", str(tmp_path / "calibration.json")]
    sources += ["--timestamps", str(tmp_path / "timestamps.csv"), "--own-points", str(tmp_path / "own.yaml")]
    options = ["--no-cache", "--exports", "csv", "--out", str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(app, ["reconstruct", *sources, *options])
    assert result.exit_code == 0, result.output
    with (tmp_path / "out" / "rigid.csv").open() as file:
        head, *rows = csv.reader(file)
    assert {"person_1_racket_x_m", "box_qw"} <= set(head)
    assert np.mean([row[head.index("box_x_m")] != "" for row in rows]) > 0.9
    (tmp_path / "own.yaml").write_text("bones: [[tip, hoof]]")
    result = CliRunner().invoke(app, ["check", *sources])
    assert result.exit_code == 2
    assert "no points hoof; points of your own are tip, left, right, grip, box_a" in " ".join(result.output.split())
