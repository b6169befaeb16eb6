"""Sessions with unusual clocks in the whole service: allowed extremes, and refused sessions."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest

from pipeline.validation.simulation.rigs import Clock
from pipeline.validation.simulation.scenes import Simulation, find_scene, record, simulation_files
from tests.e2e.serving import Served
from tests.hostile.keypoints import archive, keypoint_files
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.media import write_video

pytestmark = pytest.mark.xdist_group("service")

Parts = list[tuple[str, Any]]
TWO_HOURS_S = 7200.0


def simulate(clock: Clock, duration_s: float) -> Simulation:
    return record(replace(find_scene("unsynchronised"), clock=clock, duration_s=duration_s), seed=4, num_views=3)


def keypoint_parts(files: dict[str, bytes]) -> Parts:
    """Files as parts of a form; without timestamps frames have 25 Hz."""
    kinds = {".zip": "keypoints", ".csv": "timestamps", ".json": "calibration"}
    parts: Parts = [(kinds[Path(name).suffix], (name, content)) for name, content in files.items()]
    if "timestamps.csv" not in files:
        parts.append(("manifest", (None, json.dumps({"frame_rate_hz": 25.0}))))
    return parts


def video_parts(videos: list[Path], rig: Path) -> Parts:
    return [
        *(("videos", (path.name, path.read_bytes())) for path in videos),
        ("calibration", (rig.name, rig.read_bytes())),
    ]


def reconstruct(served: Served, parts: Parts, **spec: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Reconstruct a session; return its preflight and its job."""
    answer = served.client.post("/v1/jobs", files=[*parts, ("spec", (None, json.dumps(spec)))])
    assert answer.status_code == 202, answer.text
    job = served.wait_for_end(answer.json()["id"])
    assert job["state"] == "succeeded", job
    session = served.client.get(answer.json()["urls"]["session"]).json()
    return session["preflight"], job


def people(served: Served, job: dict[str, Any]) -> list[dict[str, Any]]:
    metrics = served.client.get(f"/v1/jobs/{job['id']}/results/metrics.json").json()
    found: list[dict[str, Any]] = metrics["people"]
    return found


@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_5_hz_beside_240_hz(served: Served, method: str) -> None:
    files = keypoint_files(simulate(Clock(240.0, (240.0, 5.0, 240.0)), 1.0))
    preflight, job = reconstruct(served, keypoint_parts(files), method=method, output_rate_hz=30)
    assert [camera["frame_rate_hz"] for camera in preflight["cameras"]] == pytest.approx([240.0, 5.0, 240.0])
    assert preflight["timebase"]["frame_rate_hz"] == pytest.approx(240.0)
    assert len(people(served, job)) >= 2


@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_tenth_of_second_of_keypoints(served: Served, method: str) -> None:
    files = keypoint_files(simulate(Clock(25.0), 0.1))
    preflight, job = reconstruct(served, keypoint_parts(files), method=method)
    assert preflight["timebase"]["num_frames"] == 3
    assert len(people(served, job)) == 3


@pytest.mark.parametrize("num_frames", [2, 3])
def test_tenth_of_second_of_video(served: Served, tmp_path: Path, num_frames: int) -> None:
    videos = [write_video(tmp_path / f"{name}.mp4", num_frames) for name in ("a", "b")]
    preflight, job = reconstruct(served, video_parts(videos, calibration(tmp_path / "rig.json", ["a", "b"])))
    assert preflight["timebase"] == {"start_time_s": 0.0, "frame_rate_hz": 25.0, "num_frames": num_frames}
    assert people(served, job) == []


def test_24_frames_second_on_clock_of_60_hz(served: Served, tmp_path: Path) -> None:
    stamps = [round(1000 * int(2.5 * number) / 60) for number in range(49)]
    videos = [write_video(tmp_path / f"{name}.mp4", 49, stamps=stamps) for name in ("a", "b")]
    preflight, job = reconstruct(served, video_parts(videos, calibration(tmp_path / "rig.json", ["a", "b"])))
    assert preflight["timebase"]["frame_rate_hz"] == pytest.approx(24.0, rel=2e-3)
    assert (job["num_frames"], job["stages"][1]["total"]) == (49, 98)


@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_two_hours_of_keypoints_with_somebody_now_and_then(served: Served, method: str) -> None:
    """The session has frames for a second at the start, in the middle and at the end; other frames were dropped."""
    once = simulate(Clock(25.0), 1.0)
    files = {"calibration.json": keypoint_files(once)["calibration.json"]}
    for name, content in sorted(frames_of(once).items()):
        taken = {
            f"frame_{number + round(start_s * 25):012d}_keypoints.json": frame
            for start_s in (0.0, 0.5 * TWO_HOURS_S, TWO_HOURS_S - 1.0)
            for number, frame in enumerate(content)
        }
        files[f"{name}.zip"] = archive(taken)
    preflight, job = reconstruct(served, keypoint_parts(files), method=method)
    assert preflight["timebase"]["num_frames"] == 180_000
    assert job["duration_s"] == TWO_HOURS_S
    starts = sorted(person["start_frame"] for person in people(served, job))
    assert {start // 1000 for start in starts} == {0, 90, 179}
    assert sum(stage["total"] for stage in job["stages"]) < 1000  # units of work, not 180,000 frames


@pytest.mark.benchmark
def test_two_hours_of_keypoints_with_file_for_every_frame(served: Served) -> None:
    """The session has 360,000 files, with people for a second of every ten minutes."""
    once = simulate(Clock(25.0), 1.0)
    files = {"calibration.json": keypoint_files(once)["calibration.json"]}
    for name, content in sorted(frames_of(once).items())[:2]:
        files[f"{name}.zip"] = archive(
            {
                f"frame_{number:012d}_keypoints.json": content[number % 15_000]
                if number % 15_000 < len(content)
                else b'{"people":[]}'
                for number in range(180_000)
            }
        )
    calibration_of_two = json.loads(files["calibration.json"])
    calibration_of_two["cameras"] = calibration_of_two["cameras"][:2]
    files["calibration.json"] = json.dumps(calibration_of_two).encode()
    served.client.timeout = httpx2.Timeout(300.0)
    preflight, job = reconstruct(served, keypoint_parts(files))
    assert preflight["timebase"]["num_frames"] == 180_000
    assert {person["start_frame"] // 15_000 for person in people(served, job)} <= set(range(12))
    assert people(served, job)
    peak_kib = max(peak_kib_of(process) for process in served.tree())
    assert peak_kib < 2 * 2**20


def peak_kib_of(process: psutil.Process) -> int:
    """Peak memory of a process so far."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0])


def frames_of(simulation: Simulation) -> dict[str, list[bytes]]:
    """Contents of each camera's files in order."""
    frames: dict[str, list[bytes]] = {}
    for name, content in simulation_files(simulation):
        if name.startswith("keypoints/"):
            frames.setdefault(name.split("/")[1], []).append(content)
    return frames


def errors(answer: httpx2.Response) -> list[tuple[str, str, str]]:
    assert answer.status_code == 422, answer.text
    found = answer.json()["errors"]
    assert all(item["hint"] for item in found)
    return [(item["code"], item["camera"], item["pointer"]) for item in found]


def test_offsets_that_make_millions_of_frames_are_refused(served: Served, tmp_path: Path) -> None:
    videos = [write_video(tmp_path / f"{name}.mp4", 10) for name in "abcd"]
    parts = video_parts(videos, calibration(tmp_path / "rig.json", list("abcd")))

    def send(**offsets_s: float) -> httpx2.Response:
        cameras = [
            {"name": name, "offset_s": offset_s, "rate": 1000 if name == "a" else 100}
            for name, offset_s in offsets_s.items()
        ]
        return served.client.post("/v1/jobs", files=[*parts, ("manifest", (None, json.dumps({"cameras": cameras})))])

    assert errors(send(a=-86_400, b=-86_400, c=86_400, d=86_400)) == [
        ("session_too_long", "c", "/manifest/cameras/2/offset_s")
    ]
    assert errors(send(a=0, b=0, c=20_000, d=20_000)) == [("too_many_frames", "a", "/manifest/cameras/0/rate")]
    assert errors(send(a=0, b=10, c=20, d=20)) == [
        ("no_overlap", "a", "/manifest/cameras/0/offset_s"),
        ("no_overlap", "b", "/manifest/cameras/1/offset_s"),
    ]


def test_timestamps_that_would_make_millions_of_frames(served: Served) -> None:
    files = keypoint_files(simulate(Clock(25.0), 0.3))
    *rows, last = files["timestamps.csv"].decode().splitlines()
    for last_s, code in (("43000", "too_many_frames"), ("900000", "session_too_long"), ("1e8", "timestamps_start")):
        table = "\n".join([*rows, f"{last.rpartition(',')[0]},{last_s}"]).encode()
        answer = served.client.post("/v1/jobs", files=keypoint_parts(files | {"timestamps.csv": table}))
        (found,) = errors(answer)
        assert (found[0], found[2]) == (code, "/timestamps")


def test_output_rate_that_would_make_millions_of_frames(served: Served) -> None:
    files = {name: one for name, one in keypoint_files(simulate(Clock(25.0), 0.3)).items() if name != "timestamps.csv"}
    far = {f"frame_{number}_keypoints.json": b'{"people": []}' for number in (1, 900_000)}
    files = {name: archive(far) if name.endswith(".zip") else one for name, one in files.items()}
    first = next(name for name in files if name.endswith(".zip"))
    files[first] = archive(far | {"frame_2_keypoints.json": frames_of(simulate(Clock(25.0), 0.3))["cam_00"][2]})
    spec = ("spec", (None, json.dumps({"output_rate_hz": 60})))
    answer = served.client.post("/v1/jobs", files=[*keypoint_parts(files), spec])
    assert answer.status_code == 422, answer.text
    assert [(item["code"], item["pointer"]) for item in answer.json()["errors"]] == [
        ("too_many_frames", "/spec/output_rate_hz")
    ]
