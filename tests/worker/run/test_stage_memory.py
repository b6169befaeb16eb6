"""Memory of the stages for the joints and people of a long session of keypoints: no more than is foreseen."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.preflight_record import Preflight, PreflightTimebase
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.run.space import memory_of_people
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.scenes import Joints, find_scene, record
from tests.records import encode_record
from worker.run.chunk import Work
from worker.run.execution import run_chunk
from worker.store.files.artifacts import LocalArtifacts
from worker.store.files.file_keys import record_key
from worker.store.model.session_records import InputFile, Session
from worker.store.model.work import Claim
from worker.store.spec import JobSpec

SESSION_ID = "0190"
PAYLOAD = {"camera": None, "start_frame": 0, "stop_frame": 1, "chunk_frames": 1}


def long_session(num_joints: int, joints: Joints) -> KeypointSession:
    """Session of two people in four cameras with a number of joints, or a few more."""
    once = record(replace(find_scene("room"), cast=Cast(2, (3.0, 3.0)), duration_s=8.0), seed=4, joints=joints)
    num_once = once.timebase.num_frames
    num_repeats = -(-num_joints // (2 * sum(one.score.size for one in once.detections.values())))
    detections, times = {}, {}
    for camera, one in once.detections.items():
        back = slice(None, None, -1)
        frame = np.concatenate([one.frame, 2 * num_once - 1 - one.frame[back]])
        starts = np.repeat(2 * num_once * np.arange(num_repeats), len(frame))
        values = [np.concatenate([part, part[back]]) for part in (one.keypoints_px, one.score, one.box_px)]
        tiled = [np.tile(part, (num_repeats, *(1,) * (part.ndim - 1))) for part in values]
        detections[camera] = Detections(camera, starts + np.tile(frame, num_repeats), *tiled)
        detections[camera].keypoints_px[:] += np.random.default_rng(1).normal(0.0, 0.2, tiled[0].shape)
        times[camera] = FrameTimes(np.arange(2 * num_once * num_repeats) / once.timebase.frame_rate_hz)
    timebase = Timebase(0.0, once.timebase.frame_rate_hz, 2 * num_once * num_repeats)
    return KeypointSession(once.cameras, times, timebase, detections, once.joints, {}, ())


PREFLIGHT = Preflight((), PreflightTimebase(0.0, 25.0, 1), (range(1),))


def work(folder: Path, stage: str) -> Work:
    content = (folder / "record").read_bytes()
    artifacts = LocalArtifacts(folder / "artifacts")
    artifacts.put_bytes(record_key(SESSION_ID), content)
    file = InputFile("cam_00.zip", "keypoints", "sessions/0190/inputs/0-cam_00.zip", 1, "0" * 64)
    digest = hashlib.sha256(content).hexdigest()
    session = Session(SESSION_ID, "take", datetime.now(UTC), (file,), PREFLIGHT, record_sha256=digest)
    claim = Claim(
        1, "job", SESSION_ID, stage, 0, PAYLOAD, 100, "0" * 64, JobSpec(smoothing="none"), "token", 1, 1, None
    )

    def outputs(stage: str, chunks: slice = slice(None)) -> list[bytes]:
        return [(folder / stage).read_bytes()][chunks]

    def interim(stage: str, chunks: slice = slice(None)) -> list[bytes]:
        return outputs(f"{stage}-interim", chunks)

    def copy_output(stage: str, chunk: int, path: Path, is_interim: bool) -> None:
        shutil.copyfile(folder / f"{stage}-interim" if is_interim else folder / stage, path)

    scratch = folder / "scratch"
    scratch.mkdir(exist_ok=True)
    return Work(claim, session, artifacts, outputs, scratch, lambda: None, lambda: None, interim, copy_output, None)


def run(folder: Path, stage: str) -> None:
    """Run a stage in this process, and store its output."""
    output = run_chunk(work(folder, stage))
    for name, content in ((stage, output.content), (f"{stage}-interim", output.interim)):
        if isinstance(content, Path):
            content.replace(folder / name)
        elif content is not None:
            (folder / name).write_bytes(content)


def peak_bytes(folder: Path, stage: str) -> int:
    """Peak memory of a process that runs a stage, without pages of files, which the system takes back."""
    command = [sys.executable, "-c", "import sys; from tests.worker.run.test_stage_memory import run; "
               "from pathlib import Path; run(Path(sys.argv[1]), sys.argv[2])", str(folder), stage]  # fmt: skip
    environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": str(2**20), "OMP_NUM_THREADS": "1"}
    peak_kib = 0
    with subprocess.Popen(command, env=environment) as running:
        while running.poll() is None:
            status = Path(f"/proc/{running.pid}/status").read_text()
            peak_kib = max(peak_kib, *map(int, re.findall(r"RssAnon:\s+(\d+)", status)), 0)
            time.sleep(0.01)
    assert running.returncode == 0
    return 1024 * peak_kib


@pytest.mark.benchmark
@pytest.mark.parametrize(("joints", "sizes"), [("body", (500_000, 2_500_000)), ("whole", (1_000_000, 4_000_000))])
@pytest.mark.skipif(sys.platform != "linux", reason="other systems count other memory")
def test_every_stage_takes_memory_that_is_foreseen(tmp_path: Path, joints: Joints, sizes: tuple[int, int]) -> None:
    stages_in_order = ("check_session", "associate", "identify", "fit", "hold_feet", "export")
    foreseen, peaks = [], []
    for number, wanted in enumerate(sizes):
        folder = tmp_path / str(number)
        folder.mkdir()
        session = long_session(wanted, joints)
        (folder / "record").write_bytes(encode_record(session))
        num_joints = sum(detections.score.size for detections in session.detections.values())
        num_people = 2 * session.timebase.num_frames
        foreseen.append(memory_of_people(num_joints, num_people, len(session.joints.names)))
        peaks.append([peak_bytes(folder, stage) for stage in stages_in_order])
    growth = (np.diff(peaks, axis=0)[0] / np.diff(foreseen)).round(2).tolist()
    by_stage = dict(zip(stages_in_order, growth, strict=True))
    assert max(growth) < 1.0, json.dumps(by_stage)
