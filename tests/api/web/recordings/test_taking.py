"""Sessions and calibrations from takes: cameras, offsets, what is left out, and what goes wrong."""

import json
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from api.web.settings import Settings
from tests.api.conftest import PREFLIGHT, Live, problem_of, running
from tests.api.web.recordings.conftest import STARTED_LATE_S, OpenedRecording, connected_phone, opened_recording, taken

# Checks files as the program of the other tests does, calibrations alone and videos without one too: the first video
# takes its place.
CALIBRATING = PREFLIGHT.replace('if not {"--calibration"} <', 'if False and not {"--calibration"} <').replace(
    "arguments = sys.argv[1:]",
    """arguments = sys.argv[1:]
if "--videos" in arguments and "--calibration" not in arguments:
    first = arguments.index("--videos") + 1
    end = next((k for k in range(first, len(arguments)) if arguments[k].startswith("--")), len(arguments))
    arguments[end:end] = ["--calibration", arguments[first]]""",
)


@pytest.fixture(scope="module")
def studio(make_settings: Callable[..., Settings], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """Running service with a calibration, whose jobs nobody works at."""
    script = tmp_path_factory.mktemp("preflight") / "preflight.py"
    script.write_text(CALIBRATING, encoding="utf-8")
    command = (sys.executable, "-I", "-S", str(script))
    with running(make_settings(preflight_command=command, max_json_bytes=4_000)) as live:
        yield live


@pytest.fixture
def filmed(studio: Live) -> Iterator[tuple[OpenedRecording, list[dict[str, Any]]]]:
    """Recording of two phones with a take that both have sent, and messages to hosts."""
    recording = opened_recording(studio)
    with (
        recording.host() as host,
        connected_phone(recording, "Left") as left,
        connected_phone(recording, "Right") as right,
    ):
        take = taken(host)
        left.record(1, take["start_s"], b"left1")
        right.record(1, take["start_s"] + 0.25, b"right", mime_type="video/mp4")
        state = host.state(lambda state: num_files(state) == [1, 1])
        yield recording, state["recording"]["takes"]


def num_files(state: dict[str, Any]) -> list[int]:
    """Number of files of each clip of the first take."""
    return [len(clip["files"]) for take in state["recording"]["takes"][:1] for clip in take["clips"]]


def uploads_of(state: dict[str, Any]) -> list[str]:
    """Ids of the uploads of the first take, by clip."""
    return [file["upload_id"] for clip in state["recording"]["takes"][0]["clips"] for file in clip["files"]]


def calibration_of(studio: Live) -> str:
    files = [("calibration", ("calibration.toml", b"[cam_0]"))]
    answer = studio.client.post("/v1/calibrations/from-files", files=files)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def test_take_becomes_session_with_declared_offsets(
    studio: Live, filmed: tuple[OpenedRecording, list[dict[str, Any]]]
) -> None:
    recording, _ = filmed
    spec = {"calibration_id": calibration_of(studio)}
    answer = studio.client.post(f"/v1/recordings/{recording.id}/takes/1/session", json=spec)
    assert answer.status_code == 201, answer.text
    made = answer.json()
    assert answer.headers["location"] == f"/v1/sessions/{made['session_id']}"
    assert made["job_id"] is None
    assert made["warnings"] == []
    assert made["cameras"] == pytest.approx({"Left": STARTED_LATE_S, "Right": 0.25 + STARTED_LATE_S})
    session = studio.services.store.sessions.get(made["session_id"])
    assert session.name == "Recording, Take 1"
    assert session.metadata == {"recording_id": recording.id, "take": 1}
    assert session.preflight.sync == "auto"
    stated = {said.camera: (said.file, said.offset_std_s) for said in session.preflight.recordings}
    assert stated == {"Left": ("phone-1.webm", 0.002), "Right": ("phone-2.mp4", 0.002)}
    stored = {}
    for file in session.stored_files:
        if file.kind == "video":
            with studio.services.artifacts.open(file.key, file.sha256) as content:
                stored[file.name] = content.read()
    assert stored == {"phone-1.webm": b"left1", "phone-2.mp4": b"right"}
    (take,) = recording.read()["takes"]
    assert (take["state"], take["session_id"]) == ("used", made["session_id"])
    again = studio.client.post(f"/v1/recordings/{recording.id}/takes/1/session", json=spec)
    assert again.status_code in {409, 422}
    assert studio.client.delete(f"/v1/recordings/{recording.id}").status_code == 204
    assert studio.client.get(f"/v1/sessions/{made['session_id']}").status_code == 200


def test_session_comes_with_its_job_and_once_for_idempotency_key(
    studio: Live, filmed: tuple[OpenedRecording, list[dict[str, Any]]]
) -> None:
    recording, _ = filmed
    spec = {"calibration_id": calibration_of(studio), "job": {}, "name": "Walk"}
    asked = {"json": spec, "headers": {"Idempotency-Key": f"take of {recording.id}"}}
    first, second = (
        studio.client.post(f"/v1/recordings/{recording.id}/takes/1/session", **asked)  # type: ignore[arg-type]
        for _ in range(2)
    )
    assert first.status_code == 201, first.text
    assert second.json() == first.json()
    job = studio.client.get(f"/v1/jobs/{first.json()['job_id']}").json()
    assert (job["session_id"], job["state"]) == (first.json()["session_id"], "queued")
    assert job["spec"]["sync"] == "auto"
    assert studio.client.get(f"/v1/sessions/{job['session_id']}").json()["name"] == "Walk"
    assert recording.read()["takes"][0]["job_id"] == job["id"]


def test_phones_are_told_to_forget_what_is_in_session(studio: Live) -> None:
    recording = opened_recording(studio)
    with recording.host() as host, recording.phone("Left") as left, recording.phone("Right"):
        take = taken(host)
        left.record(1, take["start_s"])
        host.state(lambda state: num_files(state) == [1])
        spec = {"calibration_id": calibration_of(studio)}
        made = studio.client.post(f"/v1/recordings/{recording.id}/takes/1/session", json=spec)
        assert made.status_code == 201, made.text
        assert [(one["code"], one["camera"]) for one in made.json()["warnings"]] == [("clip_not_sent", "Right")]
        assert left.next("delete")["take"] == 1
        left.send(
            "file", take=1, upload_id=left.upload(b"late!"), num_bytes=5, first_frame_s=1.0, std_s=0.0, duration_s=1.0
        )
        assert left.next("problem")["detail"] == "The clips of this take are in a capture already."


def test_longest_part_of_cut_clip_is_used(studio: Live) -> None:
    recording = opened_recording(studio)
    with recording.host() as host, recording.phone("Left") as left:
        take = taken(host)
        left.record(1, take["start_s"], b"short", duration_s=1.0)
        left.record(1, take["start_s"] + 3.0, b"long!", duration_s=7.5, part=2)
        host.state(lambda state: num_files(state) == [2])
        spec = {"calibration_id": calibration_of(studio)}
        made = studio.client.post(f"/v1/recordings/{recording.id}/takes/1/session", json=spec).json()
    assert [one["message"] for one in made["warnings"]] == ["Left: part 1 with 1.0 s is left out; part 2 is longer."]
    assert made["cameras"] == pytest.approx({"Left": 3.0 + STARTED_LATE_S})


def test_clip_of_wrong_clock_is_left_out_and_spoils_nothing(studio: Live) -> None:
    recording = opened_recording(studio)
    with recording.host() as host, recording.phone("<img src=x>") as left, recording.phone("Wrong") as wrong:
        take = taken(host)
        wrong.record(1, take["start_s"] - 7200.0, b"wrong")
        host.state(lambda state: num_files(state) == [1])
        address, spec = f"/v1/recordings/{recording.id}/takes/1/session", {"calibration_id": calibration_of(studio)}
        problem = problem_of(studio.client.post(address, json=spec), 409, "clips_missing")
        assert "Wrong: its first frame is not within the take" in problem["detail"]
        left.record(1, take["start_s"], b"left1", std_s=3600.0)
        state = host.state(lambda state: num_files(state) == [1, 1])
        assert [phone["name"] for phone in state["recording"]["phones"]] == ["<img src=x>", "Wrong"]
        made = studio.client.post(address, json=spec)
        assert made.status_code == 201, made.text
        assert made.json()["cameras"] == pytest.approx({"<img src=x>": STARTED_LATE_S})
        assert [(one["code"], one["camera"]) for one in made.json()["warnings"]] == [("clip_outside_take", "Wrong")]


def test_missing_clips_are_named(studio: Live) -> None:
    recording = opened_recording(studio)
    address = f"/v1/recordings/{recording.id}/takes/1/session"
    spec = {"calibration_id": calibration_of(studio)}
    problem_of(studio.client.post(address, json=spec), 404, "not_found")
    with recording.host() as host, recording.phone("Left") as left, recording.phone("Right") as right:
        host.send("start")
        start = left.next("start")
        assert problem_of(studio.client.post(address, json=spec), 409, "conflict")["hint"] == "Stop it first."
        host.send("stop")
        left.next("stop")
        problem_of(studio.client.post(address, json=spec), 409, "clips_missing")
        begun = left.begin_upload(5)
        upload_id = begun.headers["location"].rpartition("/")[2]
        times = {"first_frame_s": start["at_server_s"], "std_s": 0.0, "duration_s": 1.0, "num_bytes": 5}
        left.send("file", take=1, upload_id=upload_id, **times)
        gone = right.upload(b"right")
        right.send("file", take=1, upload_id=gone, **times)
        host.state(lambda state: num_files(state) == [1, 1])
        studio.client.delete(f"/v1/uploads/{gone}", headers={"Tus-Resumable": "1.0.0"})
        problem = problem_of(studio.client.post(address, json=spec), 422, "invalid_request")
        assert [(item["code"], item["camera"]) for item in problem["errors"]] == [
            ("upload_unfinished", "Left"),
            ("upload_unknown", "Right"),
        ]
        uploads = [left.record(1, start["at_server_s"]), right.record(1, start["at_server_s"], b"WRONG")]
        host.state(lambda state: uploads_of(state) == uploads)
        problem = problem_of(studio.client.post(address, json=spec), 422, "invalid_request")
        assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [("video_unreadable", None)]
        problem = problem_of(studio.client.post(address, json={"calibration_id": recording.id}), 422, "invalid_request")
        assert "calibration_unknown" in {item["code"] for item in problem["errors"]}
        problem_of(studio.client.post(address, json={}), 422, "invalid_request")
    # Nothing was used up: the take is there still.
    assert recording.read()["takes"][0]["state"] == "recorded"


def test_calibration_is_made_from_take_and_session_follows(
    studio: Live, filmed: tuple[OpenedRecording, list[dict[str, Any]]]
) -> None:
    recording, _ = filmed
    address = f"/v1/recordings/{recording.id}/takes/1/calibration"
    for wrong in ({}, {"stature_m": [1.78], "board": "charuco:7x5:0.06:0.045:DICT_4X4_50"}):
        problem_of(studio.client.post(address, json=wrong), 422, "invalid_request")
    answer = studio.client.post(address, json={"stature_m": [1.78], "name": "Phones"})
    assert answer.status_code == 202, answer.text
    job = answer.json()
    calibration = studio.client.get(f"/v1/calibrations/{job['id']}").json()
    assert (calibration["name"], calibration["method"]) == ("Phones", "people")
    (take,) = recording.read()["takes"]
    assert (take["state"], take["calibration_id"], take["session_id"]) == ("used", job["id"], None)
    problem_of(studio.client.post(address, json={"stature_m": [1.78]}), 422, "invalid_request")
    # The footage of the calibration becomes a session too.
    spec = {"calibration_id": calibration_of(studio)}
    made = studio.client.post(f"/v1/recordings/{recording.id}/takes/1/session", json=spec)
    assert made.status_code == 201, made.text
    assert made.json()["cameras"] == pytest.approx({"Left": STARTED_LATE_S, "Right": 0.25 + STARTED_LATE_S})
    assert recording.read()["takes"][0]["session_id"] == made.json()["session_id"]


def test_documents_of_takes_hold_no_secret(filmed: tuple[OpenedRecording, list[dict[str, Any]]]) -> None:
    recording, takes = filmed
    assert recording.secret not in json.dumps([recording.read(), takes])
