"""Keypoints of other programs: sent to the service with its real check, and given to the command line."""

import io
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from api.settings import Settings
from pipeline.simulation.files import simulation_files
from pipeline.simulation.scenes import Simulation, find_scene, record
from tests.api.conftest import Live, problem_of, running
from tests.pipeline.keypoint_programs import Files, keypoint_files, write_session

# One form of each program; tests/pipeline/capture/keypoint_files has the others.
PROGRAMS = ["AlphaPose", "MMPose", "COCO, annotations", "DeepLabCut", "MediaPipe"]


@pytest.fixture(scope="module")
def checking(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Running service with the real check of files."""
    limits = {"max_keypoints_bytes": 20_000_000, "max_session_bytes": 60_000_000, "preflight_timeout_s": 120.0}
    with running(make_settings(preflight_command=Settings().preflight_command, **limits)) as live:
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


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_session_of_the_service(checking: Live, simulation: Simulation, program: str) -> None:
    answer = checking.client.post("/v1/sessions", files=parts(simulation, keypoint_files(simulation, program)))
    assert answer.status_code == 201, answer.text
    preflight = answer.json()["preflight"]
    assert [one["evidence"] for one in preflight["findings"] if one["code"] == "keypoints_form"] == [
        {"forms": [program.split(",", maxsplit=1)[0]]}
    ]
    assert {camera["name"] for camera in preflight["cameras"]} == {camera.name for camera in simulation.cameras}


def test_a_wrong_cell_is_named_with_file_frame_and_field(checking: Live, simulation: Simulation) -> None:
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


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_folder_at_the_command_line(tmp_path: Path, simulation: Simulation, program: str) -> None:
    write_session(simulation, program, tmp_path)
    words = ["check", "--keypoints", str(tmp_path / "keypoints"), "--timestamps", str(tmp_path / "timestamps.csv")]
    answer = CliRunner().invoke(app, [*words, "--calibration", str(tmp_path / "calibration.json"), "--json"])
    assert answer.exit_code == 0, answer.output
    findings = json.loads(answer.stdout)["findings"]
    assert program.split(",", maxsplit=1)[0] in next(
        one["message"] for one in findings if one["code"] == "keypoints_form"
    )
