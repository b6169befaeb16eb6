"""Calibrations that jobs make: from the request to a session that uses the result."""

import io
import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from api.web.settings import Settings
from pipeline.calibration.board.spec import parse_board
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from pipeline.validation.simulation.scenes import Scene, Simulation, record, simulation_files
from tests.api.conftest import Live, problem_of, running
from tests.pipeline.calibration.board.filmed_boards import BoardPainter, board_poses
from tests.pipeline.media import write_pictures
from tests.warm_programs import WarmPrograms
from worker.run.execution import run_chunk
from worker.run.runner import Runner
from worker.store.model.work import ANY_CHUNK

SPEC = "charuco:5x4:0.16:0.12:DICT_4X4_50"
# Small pictures: what is tested is the way through the service.
RIG = Rig(Layout.RING, 3, (2.0, 1.8), 2.0, size_px=(640, 360), focal_px=400.0)


@pytest.fixture(scope="module")
def making(make_settings: Callable[..., Settings], warm_programs: WarmPrograms) -> Iterator[Live]:
    """Running service with the real check of files, for larger files."""
    limits = {
        "max_file_bytes": 20_000_000,
        "max_session_bytes": 60_000_000,
        "max_keypoints_bytes": 20_000_000,
        "max_calibration_bytes": 1_000_000,
        "preflight_timeout_s": 120.0,
    }
    command = warm_programs.command("pipeline.capture.preflight")
    with running(make_settings(preflight_command=command, **limits)) as live:
        yield live


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Videos of a board that lies on the floor and is then held towards one camera after the other."""
    folder, rng, board = tmp_path_factory.mktemp("videos"), np.random.default_rng(11), parse_board(SPEC)
    cameras = build_cameras(RIG, np.random.default_rng(0))
    _, poses = board_poses(cameras, board, 12, rng)
    paths = []
    for camera in cameras:
        painter = BoardPainter(camera, board)
        pictures = [painter.paint(pose, rng) for pose in poses]
        paths.append(write_pictures(folder / f"{camera.name}.mp4", pictures, {"crf": "12", "preset": "ultrafast"}))
    return paths


def work(live: Live) -> None:
    """Do the work that waits, as a worker does."""
    store, artifacts = live.services.store, live.services.artifacts
    runner = Runner(
        store,
        artifacts,
        lambda: None,
        run_chunk,
        60.0,
        5.0,
        lambda: False,
        lambda: None,
        lambda: True,
        ANY_CHUNK,
        lambda: None,
    )
    runner.work(claim_for_s=300.0)


def send(live: Live, paths: list[Path], **spec: Any) -> Any:
    parts = [("videos", (path.name, path.read_bytes())) for path in paths]
    return live.client.post("/v1/calibrations", files=[*parts, ("spec", (None, json.dumps(spec).encode()))])


@pytest.mark.slow
def test_job_makes_calibration_from_board(making: Live, videos: list[Path]) -> None:
    answer = send(making, videos, method="board", board=SPEC, name="Studio B")
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert answer.headers["location"] == job["urls"]["self"]
    assert (job["kind"], job["calibration_id"]) == ("calibration", job["id"])
    assert [stage["name"] for stage in job["stages"]] == ["find_board", "make_calibration"]
    address = f"/v1/calibrations/{job['id']}"
    assert making.client.get(address).json()["state"] == "queued"
    problem_of(making.client.get(f"{address}/file"), 409, "not_finished")
    problem_of(making.client.delete(address), 409, "conflict")
    # Its videos are no capture: they can't be reconstructed, and are not listed.
    problem_of(making.client.post(f"{job['urls']['session']}/jobs", json={}), 409, "conflict")
    assert making.client.get("/v1/sessions").json()["sessions"] == []

    work(making)
    calibration = making.client.get(address).json()
    assert calibration["state"] == "ready", making.client.get(job["urls"]["self"]).json()["error"]
    assert (calibration["name"], calibration["method"], calibration["error"]) == ("Studio B", "board", None)
    assert [camera["name"] for camera in calibration["cameras"]] == [path.stem for path in videos]
    assert all(1.5 < camera["position_m"][2] < 2.5 for camera in calibration["cameras"])
    assert calibration["report"]["reprojection_error_px"] < 0.5
    names = {one["name"] for one in making.client.get(job["urls"]["results"]).json()["results"]}
    assert names == {"calibration.json", "report.json", *(f"coverage_{path.stem}.svg" for path in videos)}

    # The same videos as a session with the calibration's id; a second one after the calibration's job is deleted.
    parts: list[tuple[str, Any]] = [("videos", (path.name, path.read_bytes())) for path in videos]
    parts.append(("calibration_id", (None, job["id"].encode())))
    assert making.client.post("/v1/sessions", files=parts).status_code == 201
    assert making.client.delete(job["urls"]["self"]).status_code == 204
    assert making.client.post("/v1/sessions", files=parts).status_code == 201
    assert making.client.get(address).json()["state"] == "ready"
    assert making.client.delete(address).status_code == 204
    problem_of(making.client.get(job["urls"]["session"]), 404, "not_found")


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Zip archives of photographs of a board, one for each of two cameras."""
    folder, rng, board = tmp_path_factory.mktemp("photographs"), np.random.default_rng(12), parse_board(SPEC)
    cameras = build_cameras(RIG, np.random.default_rng(0))[:2]
    _, poses = board_poses(cameras, board, 20, rng)
    paths = []
    for number, camera in enumerate(cameras):
        painter = BoardPainter(camera, board)
        paths.append(folder / f"{camera.name}.zip")
        with zipfile.ZipFile(paths[-1], "w") as archive:
            for k, pose in enumerate(poses[15 + 2 * number :: 4]):
                _, content = cv2.imencode(".png", painter.paint(pose, rng)[..., ::-1])
                archive.writestr(f"board/IMG_{k:04d}.png", content.tobytes())
    return paths


@pytest.mark.slow
def test_photographs_of_board_give_intrinsics(making: Live, photographs: list[Path]) -> None:
    parts = [("images", (path.name, path.read_bytes())) for path in photographs]
    spec = ("spec", (None, json.dumps({"method": "board", "board": SPEC}).encode()))
    answer = making.client.post("/v1/calibrations", files=[*parts, spec])
    assert answer.status_code == 202, answer.text
    work(making)
    calibration = making.client.get(f"/v1/calibrations/{answer.json()['id']}").json()
    assert calibration["state"] == "ready", making.client.get(answer.json()["urls"]["self"]).json()["error"]
    assert calibration["report"]["has_extrinsics"] is False
    truth = build_cameras(RIG, np.random.default_rng(0))
    for found, camera in zip(calibration["cameras"], truth, strict=False):
        assert found["name"] == camera.name
        assert abs(found["matrix"][0][0] / camera.matrix[0, 0] - 1) < 0.01

    # Photographs have no world, and are archives.
    point = {"name": "door", "xyz_m": [0, 0, 0], "seen_px": {}}
    spec = ("spec", (None, json.dumps({"method": "board", "board": SPEC, "known_points": [point]}).encode()))
    problem = problem_of(making.client.post("/v1/calibrations", files=[*parts, spec]), 422, "invalid_request")
    assert [(one["code"], one["pointer"]) for one in problem["errors"]] == [("part_not_allowed", "/spec/known_points")]
    spec = ("spec", (None, json.dumps({"method": "board", "board": SPEC}).encode()))
    lone = ("images", ("cam_00.png", b"\x89PNG"))
    problem = problem_of(making.client.post("/v1/calibrations", files=[lone, spec]), 422, "invalid_request")
    assert [(one["code"], one["pointer"]) for one in problem["errors"]] == [("images_archive", "/images/0")]


@pytest.mark.slow
def test_known_points_make_world_of_board(making: Live, videos: list[Path]) -> None:
    cameras = build_cameras(RIG, np.random.default_rng(0))
    xyz_m = np.array([[0.2, 0.4, 0.0], [-0.4, 0.1, 0.1], [0.2, -0.3, 0.8]])
    points: list[dict[str, Any]] = [
        {"name": f"P{k}", "xyz_m": one, "seen_px": {}} for k, one in enumerate(xyz_m.tolist())
    ]
    for camera in cameras:
        for point, seen_px in zip(points, project(camera, xyz_m), strict=True):
            if (seen_px > 0).all() and (seen_px < np.array(camera.size_px) - 1).all():
                point["seen_px"][camera.name] = seen_px.tolist()
    answer = send(making, videos, method="board", board=SPEC, known_points=points)
    assert answer.status_code == 202, answer.text
    job = answer.json()
    work(making)
    calibration = making.client.get(f"/v1/calibrations/{job['id']}").json()
    assert calibration["state"] == "ready", calibration["error"]
    assert calibration["report"]["world"].startswith("World of 3 known points")
    for found, camera in zip(calibration["cameras"], cameras, strict=True):
        np.testing.assert_allclose(found["position_m"], center_in_world(camera), atol=0.02)

    wrong = [{**points[0], "seen_px": {"cam_x": [1.0, 2.0]}}, *points[1:]]
    problem = problem_of(send(making, videos, method="board", board=SPEC, known_points=wrong), 422, "invalid_request")
    assert [(one["code"], one["pointer"]) for one in problem["errors"]] == [
        ("camera_unknown", "/spec/known_points"),
        ("known_points_few", "/spec/known_points"),
    ]
    for value in (1e9, "door", None, [1.0]):
        strange = [{**points[0], "xyz_m": [0.0, 0.0, value]}]
        answer = send(making, videos, method="board", board=SPEC, known_points=strange)
        problem = problem_of(answer, 422, "invalid_request")
        assert problem["errors"][0]["pointer"].startswith("/spec/known_points/0/xyz_m/2")


@pytest.mark.slow
def test_board_that_is_not_there_fails_job_with_cameras(making: Live, videos: list[Path]) -> None:
    job = send(making, videos, method="board", board="charuco:9x7:0.1:0.08:DICT_6X6_50").json()
    work(making)
    calibration = making.client.get(f"/v1/calibrations/{job['id']}").json()
    assert calibration["state"] == "failed"
    assert calibration["error"]["code"] == "input_error"
    assert all(f"camera {path.stem}: The board was found in 0 of" in calibration["error"]["detail"] for path in videos)
    assert not calibration["error"]["retryable"]
    parts: list[tuple[str, Any]] = [("videos", (path.name, b"")) for path in videos]
    parts.append(("calibration_id", (None, job["id"].encode())))
    problem = problem_of(making.client.post("/v1/sessions", files=parts), 422, "invalid_request")
    assert "calibration_unmade" in {one["code"] for one in problem["errors"]}


@pytest.mark.slow
def test_canceled_calibration_can_be_tried_again(making: Live, videos: list[Path]) -> None:
    answer = send(making, videos[:1], method="board", board=SPEC)
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert making.client.post(job["urls"]["cancel"]).status_code == 202
    assert making.client.get(f"/v1/calibrations/{job['id']}").json()["state"] == "canceled"
    retried = making.client.post(f"{job['urls']['self']}/retry").json()
    assert (retried["kind"], retried["attempt"]) == ("calibration", 2)
    work(making)
    calibration = making.client.get(f"/v1/calibrations/{job['id']}").json()
    # One camera alone has intrinsics and no pose, so no session can use it.
    assert (calibration["state"], calibration["report"]["has_extrinsics"]) == ("ready", False)
    parts = [("videos", (videos[0].name, b"")), ("calibration_id", (None, job["id"].encode()))]
    problem = problem_of(making.client.post("/v1/sessions", files=parts), 422, "invalid_request")
    assert [one["code"] for one in problem["errors"]] == ["calibration_unposed"]


def test_deleted_job_takes_calibration_that_it_did_not_make(making: Live, videos: list[Path]) -> None:
    job = send(making, videos[:1], method="board", board=SPEC).json()
    making.client.post(job["urls"]["cancel"])
    assert making.client.delete(job["urls"]["self"]).status_code == 204
    problem_of(making.client.get(f"/v1/calibrations/{job['id']}"), 404, "not_found")


def test_wrong_board_is_refused_at_once(making: Live, videos: list[Path]) -> None:
    problem = problem_of(send(making, videos, method="board", board="chessboard:9x6:60"), 422, "invalid_request")
    assert [(one["code"], one["hint"]) for one in problem["errors"]] == [("board_invalid", "State metres: 0.06.")]


@pytest.fixture(scope="module")
def walk() -> Simulation:
    """Two people who walk about before three cameras."""
    return record(Scene(Rig(Layout.RING, 3, (4.0, 4.0), 2.2), Cast(2, (3.0, 3.0)), duration_s=15.0), seed=3)


def keypoint_session(live: Live, simulation: Simulation) -> Any:
    """Send a simulation as a session of keypoints."""
    archives = {camera.name: io.BytesIO() for camera in simulation.cameras}
    writers = {name: zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) for name, archive in archives.items()}
    parts: list[tuple[str, Any]] = []
    for name, content in simulation_files(simulation):
        if name.startswith("keypoints/"):
            _, camera, file = name.split("/")
            writers[camera].writestr(file, content)
        elif name != "truth.npz":
            parts.append((Path(name).stem, (name, content)))
    for writer in writers.values():
        writer.close()
    parts += [("keypoints", (f"{camera}.zip", archive.getvalue())) for camera, archive in archives.items()]
    answer = live.client.post("/v1/sessions", files=parts)
    assert answer.status_code == 201, answer.text
    return answer.json()


@pytest.mark.slow
def test_people_of_session_calibrate_its_cameras(making: Live, walk: Simulation) -> None:
    session = keypoint_session(making, walk)
    answer = send(making, [], method="people", session_id=session["id"], stature_m=[1.7, 1.65])
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert [stage["name"] for stage in job["stages"]] == ["make_calibration"]
    work(making)
    calibration = making.client.get(f"/v1/calibrations/{job['id']}").json()
    assert calibration["state"] == "ready", calibration["error"]
    assert calibration["method"] == "people"
    assert calibration["source"] == {
        "board": None,
        "has_photographs": False,
        "has_intrinsics": True,
        "stature_m": [1.7, 1.65],
        "known_points": [],
    }
    assert [camera["name"] for camera in calibration["cameras"]] == [camera.name for camera in walk.cameras]
    assert all(1.9 < camera["position_m"][2] < 2.5 for camera in calibration["cameras"])
    assert calibration["report"]["reprojection_error_px"] < 5.0
    # The capture stays when the calibration goes.
    assert making.client.delete(f"/v1/calibrations/{job['id']}").status_code == 204
    assert making.client.get(session["urls"]["self"]).status_code == 200


@pytest.mark.slow
def test_footage_of_calibration_is_reconstructed_without_resend(making: Live, videos: list[Path]) -> None:
    job = send(making, videos, method="board", board=SPEC).json()
    work(making)
    body = {"session_id": job["session_id"], "calibration_id": job["id"], "manifest": {"name": "The take itself"}}
    answer = making.client.post("/v1/sessions", json=body)
    assert answer.status_code == 201, answer.text
    session = answer.json()
    assert (session["name"], session["id"] != job["session_id"]) == ("The take itself", True)
    sent = making.client.get(job["urls"]["session"]).json()["files"]
    kinds = [(one["kind"], one["name"], one["sha256"]) for one in session["files"]]
    assert [one for one in kinds if one[0] == "video"] == [
        (one["kind"], one["name"], one["sha256"]) for one in sent if one["kind"] == "video"
    ]
    assert [one[1] for one in kinds if one[0] == "calibration"] == [f"calibration-{job['id']}.json"]
    # Each has files of its own: the calibration goes with its session, and the new session stays whole.
    assert making.client.delete(f"/v1/calibrations/{job['id']}").status_code == 204
    problem_of(making.client.get(job["urls"]["session"]), 404, "not_found")
    artifacts, stored = making.services.artifacts, making.services.store.sessions.get(session["id"])
    for file in stored.files:
        with artifacts.open(file.key, file.sha256) as content:
            assert len(content.read()) == file.num_bytes
    assert making.client.delete(session["urls"]["self"]).status_code == 204
    assert not any(artifacts.exists(file.key) for file in stored.files)


@pytest.mark.slow
def test_keypoints_are_reconstructed_with_calibration_from_them(making: Live, walk: Simulation) -> None:
    session = keypoint_session(making, walk)
    calibration = send(making, [], method="people", session_id=session["id"], stature_m=[1.7]).json()
    work(making)
    body = {"session_id": session["id"], "calibration_id": calibration["id"], "spec": {"exports": ["csv"]}}
    answer = making.client.post("/v1/jobs", json=body)
    assert answer.status_code == 202, answer.text
    job = answer.json()
    other = making.client.get(job["urls"]["session"]).json()
    assert other["preflight"]["timebase"] == session["preflight"]["timebase"]
    assert {one["kind"] for one in other["files"]} == {"keypoints", "timestamps", "calibration"}
    # The first session goes before the job of the second one begins.
    assert making.client.delete(session["urls"]["self"]).status_code == 204
    work(making)
    done = making.client.get(job["urls"]["self"]).json()
    assert (done["state"], done["error"]) == ("succeeded", None)
    metrics = making.client.get(f"{job['urls']['results']}/metrics.json").json()
    assert len(metrics["people"]) == 2


def test_footage_that_cannot_be_used_is_named(making: Live, walk: Simulation) -> None:
    unknown = "0190b7a4-0000-7000-8000-000000000000"
    session = keypoint_session(making, walk)
    for body, expected in (
        ({"session_id": unknown}, {("session_unknown", "/session_id"), ("missing_part", "/calibration")}),
        ({"session_id": session["id"]}, {("missing_part", "/calibration")}),
        (
            {"session_id": session["id"], "videos": [unknown], "calibration_id": unknown},
            {
                ("upload_unknown", "/videos/0"),
                ("part_not_allowed", "/session_id"),
                ("calibration_unknown", "/calibration_id"),
            },
        ),
        ({"session_id": "session 1"}, {("wrong_format", "/session_id")}),
    ):
        problem = problem_of(making.client.post("/v1/sessions", json=body), 422, "invalid_request")
        assert {(one["code"], one["pointer"]) for one in problem["errors"]} == expected


def test_missing_parts_of_people_are_named(making: Live, videos: list[Path]) -> None:
    session_id = "0190b7a4-0000-7000-8000-000000000000"
    for spec, expected in (
        ({}, {("missing_part", "/videos"), ("missing_part", "/spec/stature_m")}),
        ({"stature_m": [1.7], "board": SPEC}, {("missing_part", "/videos"), ("part_not_allowed", "/spec/board")}),
        ({"session_id": session_id}, {("missing_part", "/spec/stature_m")}),
    ):
        problem = problem_of(send(making, [], method="people", **spec), 422, "invalid_request")
        assert {(one["code"], one["pointer"]) for one in problem["errors"]} == expected
    with_videos = send(making, videos[:1], method="people", stature_m=[1.7], session_id=session_id)
    problem = problem_of(with_videos, 422, "invalid_request")
    assert {(one["code"], one["pointer"]) for one in problem["errors"]} == {("part_not_allowed", "/videos")}
    for statures in ([0.2], [178.0], ["tall"]):
        problem_of(send(making, videos[:1], method="people", stature_m=statures), 422, "invalid_request")
    problem_of(send(making, [], method="people", stature_m=[1.7], session_id=session_id), 404, "not_found")
    board = send(making, videos, method="board", board=SPEC).json()
    problem = problem_of(
        send(making, [], method="people", stature_m=[1.7], session_id=board["session_id"]), 422, "invalid_request"
    )
    assert [(one["code"], one["pointer"]) for one in problem["errors"]] == [("not_a_capture", "/spec/session_id")]
