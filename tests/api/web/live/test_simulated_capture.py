"""A simulated room by the client, the service, and the real computation; what is kept is an ordinary session."""

import asyncio
import dataclasses
import io
import json
import re
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from api.web.settings import Settings
from multicap.live import LiveError, LiveOptions, connect, connect_sync
from pipeline.calibration.write import encode_toml
from pipeline.capture.keypoints import open_keypoints
from pipeline.core.errors import InputError
from pipeline.core.joints import MARKED_AT_CENTERS, JointOffsets
from pipeline.detection.entries import find_entry
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import LiveInstant, LiveSkeleton, RecordedFrame, recorded_frames
from pipeline.run.live.settings import LiveSettings
from pipeline.validation.simulation.scenes import Simulation, find_scene, record, simulation_files
from tests.api.conftest import Live, running
from tests.pipeline.simulations import write_simulation
from tests.warm_programs import WarmPrograms

# Bones are learnt in the first half of the take.
LEARN_S = 0.4
NETWORK = "movenet-multipose"
PAGE = (Path(__file__).parents[4] / "docs/reference/live-protocol.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def computing(make_settings: Callable[..., Settings], warm_programs: WarmPrograms) -> Iterator[Live]:
    """Running service with the real check of files and the real computation."""
    commands = {
        "preflight_command": warm_programs.command("pipeline.capture.preflight"),
        "live_keeping_command": warm_programs.command("pipeline.run.live.keeping"),
    }
    limits = {"max_keypoints_bytes": 20_000_000, "max_session_bytes": 60_000_000, "max_calibration_bytes": 1_000_000}
    times = {"preflight_timeout_s": 120.0, "live_idle_s": 120.0, "live_answer_s": 120.0}
    with running(make_settings(**commands, **limits, **times)) as live:
        yield live


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(find_scene("room"), duration_s=1.5), seed=4, num_views=3)


@pytest.fixture(scope="module")
def calibration(room: Simulation) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(dict(simulation_files(room))["calibration.json"])
    return content


def frames_of(room: Simulation) -> list[RecordedFrame]:
    """Frames of all cameras in the order of their times, as a client sends them."""
    return recorded_frames(room.cameras, room.times, room.detections)


def rate_hz(room: Simulation) -> float:
    return float(room.timebase.frame_rate_hz)


def expected_instants(room: Simulation, offsets: JointOffsets = MARKED_AT_CENTERS) -> list[LiveInstant]:
    """Instants of the library in this process, from the numbers as packets have them."""
    capture = LiveCapture(room.cameras, room.joints, LiveSettings(rate_hz(room), learn_s=LEARN_S), offsets)
    instants = []
    for frame in frames_of(room):
        points_px, score = (values.astype(np.float32).astype(np.float64) for values in (frame.points_px, frame.score))
        instants += capture.push(frame.camera, frame.time_s, points_px, score)
    return [*instants, *capture.flush()]


def same(instants: list[LiveInstant], expected: list[LiveInstant], atol: float) -> None:
    """Compare instants, with the skeletons that everybody has in the end."""
    assert all(person.skeleton is not None for person in expected[-1].people)
    assert [instant.time_s for instant in instants] == [instant.time_s for instant in expected]
    for instant, other in zip(instants, expected, strict=True):
        assert [person.id for person in instant.people] == [person.id for person in other.people]
        for person, of_other in zip(instant.people, other.people, strict=True):
            np.testing.assert_allclose(person.xyz_m, of_other.xyz_m, atol=atol)
            assert (person.skeleton is None) == (of_other.skeleton is None)
            if person.skeleton is not None and of_other.skeleton is not None:
                for field in dataclasses.fields(LiveSkeleton):
                    sent, computed = (getattr(each, field.name) for each in (person.skeleton, of_other.skeleton))
                    np.testing.assert_allclose(sent, computed, atol=atol, err_msg=field.name)


def opened_again(live: Live, session_id: str, folder: Path) -> Any:
    """Session of the stored files."""
    session = live.services.store.sessions.get(session_id)
    folders = {}
    for file in session.files:
        with live.services.artifacts.open(file.key, file.sha256) as content:
            data = content.read()
        if file.kind == "keypoints":
            zipfile.ZipFile(io.BytesIO(data)).extractall(folder / Path(file.name).stem)
            recording = next(each for each in session.preflight.recordings if each.file == file.name)
            folders[recording.camera] = folder / Path(file.name).stem
        else:
            (folder / file.name).write_bytes(data)
    return open_keypoints(folders, folder / "calibration.json", folder / "timestamps.csv")


def test_client_gets_instants_and_session_is_kept(
    computing: Live, room: Simulation, calibration: dict[str, Any], tmp_path: Path
) -> None:
    expected = expected_instants(room)
    assert max(len(instant.people) for instant in expected) >= 2
    address = f"http://127.0.0.1:{computing.address[1]}"
    options = LiveOptions(keep=True, name="evening", learn_s=LEARN_S)
    instants: list[LiveInstant] = []
    with connect_sync(address, calibration, "coco-17", rate_hz(room), options) as capture:
        assert capture.joints == room.joints.names
        for frame in frames_of(room):
            capture.send(*frame)
            while (instant := capture.receive(timeout_s=0.0)) is not None:
                instants.append(instant)
        rest, end = capture.finish()
    same([*instants, *rest], expected, 1e-6)
    assert end.dropped == (0, 0)
    assert end.counts["taken"] == end.counts["received"] == end.kept_frames == len(frames_of(room))

    session = computing.client.get(f"/v1/sessions/{end.session_id}").raise_for_status().json()
    assert session["name"] == "evening"
    kept = opened_again(computing, str(end.session_id), tmp_path)
    assert kept.joints == room.joints
    start_s = min(times.time_s[0] for times in room.times.values())
    for camera, seen in room.detections.items():
        np.testing.assert_allclose(kept.times[camera].time_s, room.times[camera].time_s - start_s, atol=1e-9)
        np.testing.assert_array_equal(kept.detections[camera].frame, seen.frame)
        np.testing.assert_allclose(kept.detections[camera].keypoints_px, seen.keypoints_px, atol=1e-3)
    job = computing.client.post(f"/v1/sessions/{end.session_id}/jobs", json={})
    assert job.status_code == 202, job.text


def test_asynchronous_client_with_json_and_stored_calibration(
    computing: Live, room: Simulation, calibration: dict[str, Any]
) -> None:
    parts: list[tuple[str, Any]] = [
        ("calibration", ("rig.json", json.dumps(calibration).encode())),
        ("spec", (None, json.dumps({"method": "file"}))),
    ]
    stored = computing.client.post("/v1/calibrations", files=parts).raise_for_status().json()
    instants: list[LiveInstant] = []

    async def run() -> dict[str, int]:
        address = f"http://127.0.0.1:{computing.address[1]}"
        options = LiveOptions(packed=False, learn_s=LEARN_S, joint_centers=NETWORK)
        async with connect(address, stored["id"], "coco-17", rate_hz(room), options) as capture:
            for frame in frames_of(room):
                await capture.send(*frame)
            await capture.finish()
            async for instant in capture:
                instants.append(instant)  # noqa: PERF401 - mypy knows no asynchronous extend
            assert capture.end is not None
            return dict(capture.end.counts)

    counts = asyncio.run(run())
    assert counts["received"] == len(frames_of(room))
    same(instants, expected_instants(room, find_entry(NETWORK).offsets), 1e-4)


def test_client_raises_problems(computing: Live, calibration: dict[str, Any]) -> None:
    address = f"http://127.0.0.1:{computing.address[1]}"
    with pytest.raises(LiveError, match="live_fields"), connect_sync(address, {"cameras": []}, "coco-17", 25.0):
        pass
    with connect_sync(address, calibration, "coco-17", 25.0) as capture:
        capture.send(0, 0.0, np.zeros((1, 16, 2)), np.zeros((1, 16)))
        with pytest.raises(LiveError, match="live_joints"):
            capture.receive()


def test_problems_come_out_of_sending_too(computing: Live, calibration: dict[str, Any]) -> None:
    """A program that sends only still learns what is wrong, not just that the connection is closed."""
    address = f"http://127.0.0.1:{computing.address[1]}"
    wrong = np.zeros((1, 16, 2)), np.zeros((1, 16))
    with connect_sync(address, calibration, "coco-17", 25.0) as capture:

        def send() -> None:
            for number in range(2000):
                capture.send(0, number / 25, *wrong)
                time.sleep(0.005)

        with pytest.raises(LiveError, match="states 16 points"):
            send()

    async def run() -> None:
        async with connect(address, calibration, "coco-17", 25.0) as capture:
            for number in range(2000):
                await capture.send(0, number / 25, *wrong)
                await asyncio.sleep(0.005)

    with pytest.raises(LiveError, match="states 16 points"):
        asyncio.run(run())


def test_calibrations_of_any_format_are_sent(computing: Live, room: Simulation, tmp_path: Path) -> None:
    address = f"http://127.0.0.1:{computing.address[1]}"
    path = tmp_path / "rig.toml"
    path.write_bytes(encode_toml(room.cameras))
    with connect_sync(address, path, "mediapipe-33", 25.0) as capture:
        assert capture.cameras == tuple(camera.name for camera in room.cameras)
    for name in ("none.toml", "none.json"):
        with pytest.raises(InputError, match=name), connect_sync(address, tmp_path / name, "coco-17", 25.0):
            pass


def test_example_of_page(
    computing: Live,
    room: Simulation,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_simulation(room, tmp_path)
    monkeypatch.chdir(tmp_path)
    section = PAGE[PAGE.index("## In Python") : PAGE.index("## Who may connect")]
    (block,) = re.findall(r"^```python\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)
    exec(block, {"address": f"http://127.0.0.1:{computing.address[1]}"})  # noqa: S102 - our own page
    said = capsys.readouterr().out
    assert " s: 3 people" in said
    assert f"{len(frames_of(room))} frames are the session " in said
