"""Live captures from files, with detections of a simulation in the place of networks."""

import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17, JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.problems.finding_codes import STREAM_REFUSED, STREAM_SILENT
from pipeline.core.problems.session_codes import SIZE_MISMATCH
from pipeline.detection.appearance import NUM_BINS, PARTS
from pipeline.run.live.cameras import detector_pool, offsets
from pipeline.run.live.cameras import feed as feeds
from pipeline.run.live.cameras import run as runs
from pipeline.run.live.cameras.detector_pool import DetectedBodies, DetectionJob
from pipeline.run.live.cameras.feed import FrameDecoded
from pipeline.run.live.cameras.pace import DetectionPace
from pipeline.run.live.cameras.run import CameraRun, LiveListener
from pipeline.run.live.cameras.sources import CameraSource
from pipeline.run.live.cameras.totals import LiveTotals
from pipeline.run.live.records import DetectedFrame, LiveInstant
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.pipeline.media import write_pictures, write_video
from tests.pipeline.run.live.cameras.servers import serving, silent

NUM_CAMERAS, SCALE = 3, 10
CHOICES = ReconstructionConfig(profile="fast", joints="body")


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(SCENES["room"], duration_s=2.4), 0, NUM_CAMERAS)


@pytest.fixture(scope="module")
def clips(room: Simulation, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A clip of each camera: its left half tells the number of the frame, the right one that of the camera."""
    folder, paths = tmp_path_factory.mktemp("clips"), []
    for number, camera in enumerate(room.cameras):
        width, height = (side // SCALE for side in camera.size_px)
        pictures = np.full((room.timebase.num_frames, height, width, 3), 20 + 40 * number, np.uint8)
        pictures[:, :, : width // 2] = 20 + 3 * np.arange(len(pictures), dtype=np.uint8)[:, None, None, None]
        paths.append(write_pictures(folder / f"{camera.name}.mp4", list(pictures)))
    return paths


class Seen(LiveListener):
    """Messages about a capture."""

    def __init__(self) -> None:
        self.rate_hz, self.frames = 0.0, list[tuple[str, DetectedFrame]]()
        self.instants, self.sentences = list[LiveInstant](), list[str]()
        self.latencies_s, self.ticks = list[float](), 0

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        self.rate_hz = frame_rate_hz

    def take(self, camera: Camera, frame: DetectedFrame) -> None:
        self.frames.append((camera.name, frame))

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        self.instants.append(instant)
        self.latencies_s.append(latency_s)

    def tell(self, sentence: str) -> None:
        self.sentences.append(sentence)

    def tick(self, totals: LiveTotals) -> None:
        self.ticks += 1


def play(
    room: Simulation,
    clips: Sequence[Path],
    monkeypatch: pytest.MonkeyPatch,
    detection_s: float,
    stop_s: float = 60.0,
    sync_s: float | None = None,
    choices: ReconstructionConfig = CHOICES,
) -> tuple[Seen, LiveTotals]:
    """Capture the clips, with one process that takes some time for a picture."""
    turn = threading.Lock()

    def detect(job: DetectionJob) -> DetectedBodies:
        with turn:
            time.sleep(detection_s)
        image = np.memmap(job.path, np.uint8, "r", shape=job.shape)[job.slot]
        width = image.shape[1]
        number = round((np.median(image[:, : width // 2 - 4]) - 20) / 3)
        camera = room.cameras[round((np.median(image[:, width // 2 + 4 :]) - 20) / 40)]
        detections = room.detections[camera.name]
        rows = detections.frame == number
        points_px = (detections.keypoints_px[rows] + 0.5) / SCALE - 0.5
        shape = rows.sum(), len(PARTS), NUM_BINS
        colour = np.full(shape, number, np.uint8) if job.measures_colours else None
        return DetectedBodies(points_px, detections.score[rows], colour, np.full(rows.sum(), 30.0), detection_s)

    monkeypatch.setattr(runs, "verify", lambda name: None)
    monkeypatch.setattr(detector_pool, "num_processes", lambda num_cameras: 1)
    monkeypatch.setattr(detector_pool, "detect_bodies", detect)
    sources = [CameraSource(camera.name, "file", str(clip)) for camera, clip in zip(room.cameras, clips, strict=True)]
    seen = Seen()
    run = CameraRun(room.cameras, sources, choices, seen, sync_s)
    timer = threading.Timer(stop_s, run.stop)
    timer.daemon = True
    timer.start()
    with ThreadPoolExecutor(2) as pool:
        run.run(pool)
    timer.cancel()
    return seen, run.totals


def test_people_are_where_they_are(room: Simulation, clips: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    seen, totals = play(room, clips, monkeypatch, detection_s=0.001)
    num_frames = room.timebase.num_frames
    assert [camera.decoded for camera in totals.cameras] == [num_frames] * NUM_CAMERAS
    assert {camera.state for camera in totals.cameras} == {"ended"}
    assert seen.rate_hz == pytest.approx(25.0)
    assert seen.ticks >= 1
    assert len(seen.frames) == sum(camera.detected for camera in totals.cameras)
    for camera in room.cameras:
        frames = [frame for name, frame in seen.frames if name == camera.name]
        coloured = [frame for frame in frames if frame.colour is not None]
        assert np.diff([frame.time_s for frame in coloured]).min() > 0.079
        # Half of the frames at 25 Hz, unless some are dropped; of their own pictures.
        assert len(frames) / 3 - 1 < len(coloured) < len(frames) + 1
        for frame in coloured:
            assert frame.colour is not None
            assert frame.colour.shape[0] == len(frame.score)
            assert (frame.colour == round(25 * frame.time_s)).all()
    assert all(latency_s >= 0.0 for latency_s in seen.latencies_s)
    assert totals.document()["latency_ms"]["p50"] < 5000
    shoulder, num_near = COCO_17.index("left_shoulder"), 0
    for instant in seen.instants:
        truth_m = room.truth_m[:, round(25 * instant.time_s), shoulder]
        for person in instant.people:
            num_near += bool((np.linalg.norm(truth_m - person.xyz_m[shoulder], axis=-1) < 0.15).any())
    assert num_near > 0.9 * sum(len(instant.people) for instant in seen.instants) > num_frames
    assert any(person.skeleton is not None for person in seen.instants[-1].people) == (seen.instants[-1].time_s > 3.0)


def test_colours_are_left_out(room: Simulation, clips: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    choices = replace(CHOICES, appearance="off")
    seen, _ = play(room, clips, monkeypatch, detection_s=0.001, stop_s=1.5, choices=choices)
    assert seen.frames
    assert all(frame.colour is None for _, frame in seen.frames)


def test_too_many_frames_are_dropped_evenly(
    room: Simulation, clips: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """22 pictures a second can be detected, of 75 that come."""
    seen, totals = play(room, clips, monkeypatch, detection_s=0.045)
    assert seen.rate_hz == pytest.approx(5.0)
    assert "every 5th frame is used" in " ".join(seen.sentences)
    detected = [camera.detected for camera in totals.cameras]
    assert min(detected) >= 8
    assert max(detected) - min(detected) <= 2
    assert all(camera.dropped == camera.decoded - camera.detected for camera in totals.cameras)
    assert max(seen.latencies_s) < 5.0


@pytest.mark.parametrize("stop_s", [0.05, pytest.param(1.5, marks=pytest.mark.slow)])
def test_capture_is_stopped(
    room: Simulation, clips: list[Path], monkeypatch: pytest.MonkeyPatch, stop_s: float
) -> None:
    started_s = time.monotonic()
    _, totals = play(room, clips, monkeypatch, detection_s=0.001, stop_s=stop_s)
    assert time.monotonic() - started_s < 20.0
    assert totals.duration_s < 2.4


def test_all_cameras_that_are_wrong_are_named(
    room: Simulation, clips: list[Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(runs, "verify", lambda name: None)
    monkeypatch.setattr(feeds, "_OPEN_S", 4.0)
    cameras = [*room.cameras, replace(room.cameras[0], name="other")]
    square = write_video(tmp_path / "square.mp4", 3, (64, 64))
    with serving(silent) as server:
        sources = [
            CameraSource(cameras[0].name, "rtsp", f"rtsp://127.0.0.1:{server.port}/"),
            CameraSource(cameras[1].name, "file", str(clips[1])),
            CameraSource(cameras[2].name, "file", str(square)),
            CameraSource("other", "http", "http://127.0.0.1:1/"),
        ]
        with ThreadPoolExecutor(1) as pool, pytest.raises(InputError) as error:
            CameraRun(cameras, sources, CHOICES, LiveListener()).run(pool)
    assert [(problem.camera, problem.code) for problem in error.value.problems] == [
        (cameras[0].name, STREAM_SILENT),
        (cameras[2].name, SIZE_MISMATCH),
        ("other", STREAM_REFUSED),
    ]


def test_offsets_of_beginning_move_all_frames(
    room: Simulation, clips: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(offsets, "find_offsets", lambda cameras, frames, joints: [0.0, 0.25, -0.1])
    seen, _ = play(room, clips, monkeypatch, detection_s=0.001, sync_s=0.6)
    assert "Offsets: cam_00 +0.000 s, cam_01 +0.250 s, cam_02 -0.100 s." in seen.sentences
    for name, offset_s in [("cam_00", 0.0), ("cam_01", 0.25), ("cam_02", -0.1)]:
        times_s = np.array([frame.time_s for camera, frame in seen.frames if camera == name])
        assert times_s[0] == pytest.approx(offset_s, abs=0.3)
        np.testing.assert_allclose((times_s - offset_s) * 25, np.round((times_s - offset_s) * 25), atol=1e-3)
    assert min(instant.time_s for instant in seen.instants) > 0.4


def test_capture_that_ends_before_its_offsets_says_so(
    room: Simulation, clips: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, totals = play(room, clips, monkeypatch, detection_s=0.001, sync_s=9.0)
    assert (totals.instants, seen.frames) == (0, [])
    assert "before the offsets were found" in seen.sentences[-1]


def test_frames_from_before_start_are_not_counted(room: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    """Streams send while the machine is measured."""
    monkeypatch.setattr(runs, "verify", lambda name: None)
    sources = [CameraSource(camera.name, "rtsp", "rtsp://127.0.0.1/") for camera in room.cameras]
    run = CameraRun(room.cameras, sources, CHOICES, LiveListener())
    run._note_start(FrameDecoded(0, 40, 1.6))
    with ThreadPoolExecutor(1) as pool:
        run._handle(FrameDecoded(0, 43, 1.72), DetectionPace(NUM_CAMERAS, 1.6, 25.0, 1), pool)
    assert [camera.decoded for camera in run.totals.cameras] == [3, 0, 0]
