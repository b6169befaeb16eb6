"""Keypoints of other programs: sent to the service with its real check, and given to the command line."""

import io
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from typer.testing import CliRunner

import api
from api.cli.main import app
from api.web.sessions.manifest import Layout
from api.web.settings import Settings
from pipeline.calibration.vertical import AXES, turn_upright
from pipeline.calibration.write import encode
from pipeline.core.data.rigid import Rigid3
from pipeline.core.layouts import FILE_LAYOUTS
from pipeline.validation.simulation.scenes import Simulation, find_scene, record, simulation_files
from tests.api.conftest import Live, problem_of, running
from tests.pipeline.keypoint_programs import Files, freemocap_array, keypoint_files, write_session
from tests.warm_programs import WarmPrograms

PORTAL = Path(api.__file__).parent / "portal"
# One form of each program; tests/pipeline/capture/keypoint_files has the others.
# All go the same way through the service.
PROGRAMS = [
    "AlphaPose",
    "DeepLabCut, HDF5",
    *(
        pytest.param(program, marks=pytest.mark.slow)
        for program in (
            "AlphaPose, PoseFlow",
            "EasyMocap",
            "MMPose",
            "COCO, annotations",
            "DeepLabCut",
            "SLEAP",
            "MediaPipe",
            "YOLO",
        )
    ),
]


@pytest.fixture(scope="module")
def checking(make_settings: Callable[..., Settings], warm_programs: WarmPrograms) -> Iterator[Live]:
    """Running service with the real check of files."""
    limits = {"max_keypoints_bytes": 20_000_000, "max_session_bytes": 60_000_000, "preflight_timeout_s": 120.0}
    command = warm_programs.command("pipeline.capture.preflight")
    with running(make_settings(preflight_command=command, **limits)) as live:
        yield live


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=1.0), seed=4, num_views=2)


def parts(simulation: Simulation, files: Mapping[str, Files]) -> list[tuple[str, Any]]:
    sent: list[tuple[str, Any]] = [
        (Path(name).stem, (name, content))
        for name, content in simulation_files(simulation)
        if name in {"calibration.json", "timestamps.csv"}
    ]
    for camera, of_camera in files.items():
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as entries:
            for name, content in of_camera.items():
                entries.writestr(name, content)
        sent.append(("keypoints", (f"{camera}.zip", archive.getvalue())))
    return sent


def stored_rig(checking: Live, sent: list[tuple[str, Any]]) -> str:
    """Id of the calibration of a form, which the service stores."""
    rig = next(content for name, content in sent if name == "calibration")
    spec = ("spec", (None, json.dumps({"method": "file"})))
    stored = checking.client.post("/v1/calibrations", files=[("calibration", rig), spec]).raise_for_status().json()
    return str(stored["id"])


@pytest.mark.parametrize("program", PROGRAMS)
def test_session_of_service(checking: Live, simulation: Simulation, program: str) -> None:
    answer = checking.client.post("/v1/sessions", files=parts(simulation, keypoint_files(simulation, program)))
    assert answer.status_code == 201, answer.text
    preflight = answer.json()["preflight"]
    assert [one["evidence"] for one in preflight["findings"] if one["code"] == "keypoints_form"] == [
        {"forms": [program.split(",", maxsplit=1)[0]]}
    ]
    assert {camera["name"] for camera in preflight["cameras"]} == {camera.name for camera in simulation.cameras}


def test_layout_of_manifest_is_stated_in_preflight_or_refused(checking: Live, simulation: Simulation) -> None:
    sent = parts(simulation, keypoint_files(simulation, "AlphaPose"))

    def answer(**manifest: Any) -> Any:
        return checking.client.post("/v1/sessions", files=[*sent, ("manifest", (None, json.dumps(manifest)))])

    told = answer().raise_for_status().json()["preflight"]["layout"]
    assert (told["name"], told["told_by"]) == ("coco-17", "pictures")
    assert told["num_people"] > 0
    stated = answer(layout="human36m-17").raise_for_status().json()["preflight"]
    assert (stated["layout"]["name"], stated["layout"]["told_by"]) == ("human36m-17", "choice")
    assert {"layout": "human36m-17", "fits": "coco-17"} in [finding["evidence"] for finding in stated["findings"]]
    (item,) = problem_of(answer(layout="body-25b"), 422, "invalid_request")["errors"]
    assert (item["code"], item["pointer"]) == ("keypoints_layout", "/manifest/layout")


def test_layouts_of_manifest_and_page_are_those_of_files() -> None:
    assert set(get_args(Layout)) == set(FILE_LAYOUTS)
    page = (PORTAL / "send" / "view.js").read_text()
    listed = page.partition("const LAYOUTS = [")[2].partition("]")[0]
    assert {name.strip().strip('"') for name in listed.split(",") if name.strip()} == set(FILE_LAYOUTS)


@pytest.mark.parametrize("is_timed", [True, False])
def test_camera_without_people(checking: Live, simulation: Simulation, is_timed: bool) -> None:
    files = keypoint_files(simulation, "AlphaPose")
    first, second = (camera.name for camera in simulation.cameras)
    files[first] = {"alphapose-results.json": b"[]"}
    sent = [part for part in parts(simulation, files) if is_timed or part[0] != "timestamps"]
    manifest = ("manifest", (None, json.dumps({} if is_timed else {"frame_rate_hz": 25.0})))
    preflight = checking.client.post("/v1/sessions", files=[*sent, manifest]).raise_for_status().json()["preflight"]
    assert {camera["name"]: camera["num_frames"] > 0 for camera in preflight["cameras"]} == {first: False, second: True}
    assert ("camera_saw_nobody", first) in {(finding["code"], finding["camera"]) for finding in preflight["findings"]}


def test_axis_of_session_that_points_up(checking: Live, simulation: Simulation) -> None:
    """The calibration's y points up; all else is as if it were z."""
    from_upright = turn_upright(AXES["y"]).T
    cameras = [
        replace(camera, cam_from_world=Rigid3(pose.rotation @ from_upright.T, pose.translation_m))
        for camera in simulation.cameras
        for pose in [camera.cam_from_world]
    ]
    found = {}
    for up in ("z", "y"):
        sent = [
            *(
                (name, part)
                for name, part in parts(simulation, keypoint_files(simulation, "MMPose"))
                if name != "calibration"
            ),
            ("calibration", ("calibration.json", encode(cameras))),
            ("manifest", (None, json.dumps({"name": "Turned", "up": up}).encode())),
        ]
        answer = checking.client.post("/v1/sessions", files=sent)
        assert answer.status_code == 201, answer.text
        found[up] = {finding["code"]: finding["evidence"] for finding in answer.json()["preflight"]["findings"]}
    assert found["z"]["not_upright"]["up_axis"] == "y"
    assert "not_upright" not in found["y"]


@pytest.mark.parametrize("is_zip", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_array_of_all_cameras(checking: Live, simulation: Simulation, is_zip: bool) -> None:
    content, archive = io.BytesIO(), io.BytesIO()
    np.save(content, freemocap_array(simulation))
    name = "mediapipe_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as entries:
        entries.writestr(f"raw_data/{name}", content.getvalue())
        entries.writestr("raw_data/mediapipe_3dData.npy", content.getvalue()[:300])
    file = ("raw_data.zip", archive.getvalue()) if is_zip else (name, content.getvalue())
    sent = [part for part in parts(simulation, {}) if part[0] == "calibration"] + [("keypoints", file)]

    def answer(**manifest: Any) -> Any:
        part = ("manifest", (None, json.dumps({"frame_rate_hz": 25.0} | manifest)))
        return checking.client.post("/v1/sessions", files=[*sent, part])

    (item,) = problem_of(answer(), 422, "invalid_request")["errors"]
    assert (item["code"], "part1, part2" in item["hint"]) == ("pairing_unknown", True)
    preflight = answer(pair_by_order=True).raise_for_status().json()["preflight"]
    assert {camera["name"]: camera["file"] for camera in preflight["cameras"]} == {
        camera.name: file[0] for camera in simulation.cameras
    }
    sent[-1] = ("keypoints", (name, content.getvalue()[:200]))
    (item,) = problem_of(answer(pair_by_order=True), 422, "invalid_request")["errors"]
    assert (item["code"], item["pointer"]) == ("keypoints_unreadable", "/keypoints/0")


def test_wrong_cell_is_named_with_file_frame_and_field(checking: Live, simulation: Simulation) -> None:
    files = keypoint_files(simulation, "DeepLabCut")
    camera = simulation.cameras[0].name
    (name,) = files[camera]
    lines = files[camera][name].decode().splitlines()
    row = lines[9].split(",")
    row[2] = "left"
    lines[9] = ",".join(row)
    files[camera] = {name: "\n".join(lines).encode()}
    answer = checking.client.post("/v1/sessions", files=parts(simulation, files))
    (item,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert (item["code"], item["file"]) == ("keypoints_unreadable", f"{camera}/{name}")
    assert "Frame 5: 'left' is not a number" in json.dumps(item)
    assert "individual1 nose y" in json.dumps(item)


@pytest.mark.slow
def test_folders_pair_with_cameras_by_name_or_stated_order(
    checking: Live, simulation: Simulation, tmp_path: Path
) -> None:
    files = keypoint_files(simulation, "AlphaPose")
    cameras = [camera.name for camera in simulation.cameras]

    def sent(names: list[str], manifest: Mapping[str, Any] = {}) -> Any:
        renamed = {name: files[camera] for name, camera in zip(names, cameras, strict=True)}
        part = ("manifest", (None, json.dumps(manifest)))
        return checking.client.post("/v1/sessions", files=[*parts(simulation, renamed), part])

    def pairs(answer: Any) -> dict[str, str]:
        return {camera["name"]: camera["file"] for camera in answer.json()["preflight"]["cameras"]}

    words = [f"Walk 1_{camera.upper()}_alphapose" for camera in cameras]
    assert pairs(sent(words)) == {camera: f"{name}.zip" for camera, name in zip(cameras, words, strict=True)}
    others = ["view10", "view9"]
    (item,) = problem_of(sent(others), 422, "invalid_request")["errors"]
    assert item["code"] == "pairing_unknown"
    assert f"The cameras are {', '.join(cameras)}; the folders are view9, view10." in item["hint"]
    answer = sent(others, {"pair_by_order": True})
    assert pairs(answer) == dict(zip(cameras, ["view9.zip", "view10.zip"], strict=True))
    assert "paired_in_sorted_order" in {finding["code"] for finding in answer.json()["preflight"]["findings"]}

    write_session(simulation, "AlphaPose", tmp_path)
    for camera, name in zip(cameras, others, strict=True):
        (tmp_path / "keypoints" / camera).rename(tmp_path / "keypoints" / name)
    command = ["check", "--keypoints", str(tmp_path / "keypoints"), "--timestamps", str(tmp_path / "timestamps.csv")]
    command += ["--calibration", str(tmp_path / "calibration.json"), "--json"]
    codes = [
        {finding["code"] for finding in json.loads(CliRunner().invoke(app, said).stdout)["findings"]}
        for said in (command, [*command, "--pair-by-order"])
    ]
    assert codes[0] == {"pairing_unknown"}
    assert "paired_in_sorted_order" in codes[1]


@pytest.mark.slow
def test_manifest_states_archives_of_cameras(checking: Live, simulation: Simulation) -> None:
    files = keypoint_files(simulation, "AlphaPose")
    first, second = (camera.name for camera in simulation.cameras)
    # Names that would pair them the other way round, and one whose accent is composed in the manifest alone.
    names = {first: f"{second} take", second: "A\u0308hnlich (2)"}
    sent = parts(simulation, {names[camera]: files[camera] for camera in (first, second)})

    def answer(*cameras: Mapping[str, str]) -> Any:
        part = ("manifest", (None, json.dumps({"cameras": cameras})))
        return checking.client.post("/v1/sessions", files=[*sent, part])

    stated = [{"name": first, "file": f"{names[first]}.zip"}, {"name": second, "file": "\u00c4hnlich (2).zip"}]
    session = answer(*stated).raise_for_status().json()
    assert {camera["name"]: camera["file"] for camera in session["preflight"]["cameras"]} == {
        camera: f"{name}.zip" for camera, name in names.items()
    }
    by_name = checking.client.post("/v1/sessions", files=parts(simulation, files)).raise_for_status().json()
    num_frames = [[camera["num_frames"] for camera in sent["preflight"]["cameras"]] for sent in (session, by_name)]
    assert num_frames[0] == num_frames[1]
    body = {"session_id": session["id"], "calibration_id": stored_rig(checking, sent)}
    again = checking.client.post("/v1/sessions", json=body).raise_for_status().json()
    assert again["preflight"]["cameras"] == session["preflight"]["cameras"]
    problem = problem_of(answer(stated[1]), 422, "invalid_request")
    assert [(item["code"], item["camera"]) for item in problem["errors"]] == [
        ("camera_without_folder", first),
        ("camera_with_two_folders", second),
    ]

    wrong = [{"name": first, "file": "x.zip"}, {"name": second, "file": f"{names[first]}.zip"}, stated[0]]
    wrong.append({"name": "cam_x", "file": f"{names[first]}.zip"})
    problem = problem_of(answer(*wrong), 422, "invalid_request")
    assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [
        ("recording_file_unknown", "/manifest/cameras/2"),
        ("duplicate_recording", "/manifest/cameras/2"),
        ("recording_camera_unknown", "/manifest/cameras/3"),
    ]


@pytest.mark.slow
def test_rate_is_asked_for_and_kept_with_pairs_of_copied_footage(checking: Live, simulation: Simulation) -> None:
    files = keypoint_files(simulation, "AlphaPose")
    renamed = {f"view{number}": files[camera.name] for number, camera in enumerate(simulation.cameras)}
    sent = [part for part in parts(simulation, renamed) if part[0] != "timestamps"]

    def manifest(**stated: Any) -> tuple[str, Any]:
        return "manifest", (None, json.dumps({"pair_by_order": True} | stated))

    (item,) = problem_of(checking.client.post("/v1/sessions", files=[*sent, manifest()]), 422, "invalid_request")[
        "errors"
    ]
    assert (item["code"], item["field"]) == ("no_frame_rate", "frame_rate_hz")
    session = checking.client.post("/v1/sessions", files=[*sent, manifest(frame_rate_hz=50.0)]).json()
    assert session["preflight"]["timebase"]["frame_rate_hz"] == 50.0
    body: dict[str, Any] = {
        "session_id": session["id"],
        "calibration_id": stored_rig(checking, sent),
        "manifest": {"name": "Again"},
    }
    again = checking.client.post("/v1/sessions", json=body).raise_for_status().json()
    assert again["name"] == "Again"
    for field in ("cameras", "timebase"):
        assert again["preflight"][field] == session["preflight"][field]
    body["manifest"] = {"frame_rate_hz": 25.0}
    other = checking.client.post("/v1/sessions", json=body).raise_for_status().json()
    assert other["preflight"]["timebase"]["frame_rate_hz"] == 25.0
    body["manifest"] = {"pair_by_order": False}
    refused = problem_of(checking.client.post("/v1/sessions", json=body), 422, "invalid_request")
    assert [item["code"] for item in refused["errors"]] == ["pairing_unknown"]


@pytest.mark.parametrize("program", PROGRAMS)
def test_folder_at_command_line(tmp_path: Path, simulation: Simulation, program: str) -> None:
    write_session(simulation, program, tmp_path)
    words = ["check", "--keypoints", str(tmp_path / "keypoints"), "--timestamps", str(tmp_path / "timestamps.csv")]
    answer = CliRunner().invoke(app, [*words, "--calibration", str(tmp_path / "calibration.json"), "--json"])
    assert answer.exit_code == 0, answer.output
    findings = json.loads(answer.stdout)["findings"]
    assert program.split(",", maxsplit=1)[0] in next(
        one["message"] for one in findings if one["code"] == "keypoints_form"
    )
