"""Files of a session that the stages read: whole files only, from the first frame of a chunk to its last."""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pipeline.capture import preflight
from pipeline.capture.preflight_record import Preflight
from pipeline.core.data.detections import Detections
from pipeline.core.errors import InputError
from pipeline.core.joints import BODY_FEET, COCO_17, WHOLE_BODY, JointSet, without_hands
from pipeline.core.options.job_choices import ProxyChoices
from pipeline.core.runtime.jit import round_up
from pipeline.core.runtime.record_archive import decode, encode
from pipeline.detection.profiles.sizes import CameraLook
from pipeline.run.engine.stage import LOOK
from pipeline.run.warm_up import JOINT_SETS
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.cases import slow_but
from tests.e2e.captures import video_capture
from tests.worker.store.damage import overwrite
from worker.run import execution
from worker.run.chunk import StoppedError, Work
from worker.store.files.artifacts import LocalArtifacts
from worker.store.files.file_keys import input_key, record_key
from worker.store.model.session_records import InputFile, Session
from worker.store.model.work import Claim
from worker.store.spec import JobSpec

NUM_FRAMES = 20
ALONE = JobSpec(detector="movenet-multipose")


def keep(artifacts: LocalArtifacts, session_id: str, number: int, path: Path, kind: str) -> InputFile:
    key, content = input_key(session_id, number, path.name), path.read_bytes()
    artifacts.put_bytes(key, content)
    return InputFile(path.name, kind, key, len(content), hashlib.sha256(content).hexdigest())


@pytest.fixture
def artifacts(tmp_path: Path) -> LocalArtifacts:
    return LocalArtifacts(tmp_path / "artifacts")


@pytest.fixture
def session(
    tmp_path: Path, artifacts: LocalArtifacts, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Session]:
    """A session of two videos as the API keeps it, which no process has opened."""
    video_capture(tmp_path, NUM_FRAMES)
    videos = sorted((tmp_path / "videos").iterdir())
    calibration, record = tmp_path / "calibration.json", tmp_path / "record"
    arguments = ["--videos", *map(str, videos), "--calibration", str(calibration), "--record", str(record)]
    assert preflight.main(arguments) == 0
    found = Preflight.from_json(json.loads(capsys.readouterr().out))
    session_id = "0190"
    files = [keep(artifacts, session_id, number, path, "video") for number, path in enumerate(videos)]
    files.append(keep(artifacts, session_id, len(files), calibration, "calibration"))
    artifacts.put_bytes(record_key(session_id), record.read_bytes())
    digest = hashlib.sha256(record.read_bytes()).hexdigest()
    opened = execution.KeptSession()
    monkeypatch.setattr(execution, "_kept", opened)
    yield Session(session_id, "take", datetime.now(UTC), tuple(files), found, record_sha256=digest)
    opened.close()


def looks(stage: str, chunks: slice = slice(None)) -> list[bytes]:
    """Outputs of the stages before: two cameras that were found upright."""
    return [encode(CameraLook())] * len(range(2)[chunks]) if stage == LOOK else []


def no_interim(stage: str, chunks: slice = slice(None)) -> list[bytes]:
    """Read the interim outputs of earlier stages: there are none."""
    return []


def no_copy(stage: str, chunk: int, path: Path, is_interim: bool) -> None:
    """Copy an output of an earlier stage: none is asked for."""
    raise AssertionError(stage)


def work(
    session: Session,
    artifacts: LocalArtifacts,
    scratch: Path,
    on_unit: Callable[[], None] = lambda: None,
    found: bytes | None = None,
) -> Work:
    """The chunk of all frames of the camera on the left."""
    payload = {"camera": "left", "start_frame": 0, "stop_frame": NUM_FRAMES, "chunk_frames": NUM_FRAMES}
    claim = Claim(1, "job", session.id, "detect", 0, payload, NUM_FRAMES, "0" * 64, ALONE, "token", 1, 1, None)
    return Work(
        claim,
        session,
        artifacts,
        looks,
        scratch,
        on_unit,
        lambda: None,
        no_interim,
        no_copy,
        found,
    )


def stored(session: Session, tmp_path: Path) -> Path:
    (file,) = [file for file in session.files if file.name == "left.mp4"]
    return tmp_path / "artifacts" / file.key


def flip(path: Path) -> None:
    middle = path.stat().st_size // 2
    overwrite(path, middle, bytes(byte ^ 255 for byte in path.read_bytes()[middle : middle + 40]))


@pytest.mark.parametrize("is_complete", [True, False])
def test_start_loads_kernels_of_default_joints_alone(is_complete: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[JointSet] = []
    monkeypatch.setattr(execution, "open_detection", lambda *_: None)
    monkeypatch.setattr(execution, "is_complete", lambda: is_complete)
    monkeypatch.setattr(execution, "compile_kernels", loaded.extend)
    execution.warm_up()
    assert loaded == ([BODY_FEET] if is_complete else [COCO_17, WHOLE_BODY])
    # Kernels are compiled for padded sizes.
    assert round_up(len(BODY_FEET.names)) in {round_up(len(without_hands(joints).names)) for joints in JOINT_SETS}


def test_whole_video_is_worked_on(session: Session, artifacts: LocalArtifacts, tmp_path: Path) -> None:
    outcome = execution.run_chunk(work(session, artifacts, tmp_path))
    assert decode(Detections, outcome.content).camera == "left"


@pytest.mark.slow
def test_video_that_is_damaged_between_chunks_is_noticed(
    session: Session, artifacts: LocalArtifacts, tmp_path: Path
) -> None:
    execution.run_chunk(work(session, artifacts, tmp_path))
    flip(stored(session, tmp_path))
    with pytest.raises(InputError) as refused:
        execution.run_chunk(work(session, artifacts, tmp_path))
    (problem,) = refused.value.problems
    assert (problem.code, problem.file, problem.camera) == ("input_damaged", "left.mp4", "left")
    assert problem.hint is not None


@pytest.mark.parametrize("damage", slow_but([flip], [flip, Path.unlink]))
def test_video_damaged_while_decoded_leaves_no_output(
    session: Session, artifacts: LocalArtifacts, tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    damages = iter([damage])

    def on_unit() -> None:
        for once in damages:
            once(stored(session, tmp_path))

    with pytest.raises(InputError) as refused:
        execution.run_chunk(work(session, artifacts, tmp_path, on_unit))
    assert [problem.code for problem in refused.value.problems] == ["input_damaged"]


def test_interrupted_chunk_is_no_damage(session: Session, artifacts: LocalArtifacts, tmp_path: Path) -> None:
    def stop() -> None:
        raise StoppedError

    with pytest.raises(StoppedError):
        execution.run_chunk(work(session, artifacts, tmp_path, stop))


@pytest.mark.slow
def test_record_without_digest_is_read_as_before(session: Session, artifacts: LocalArtifacts, tmp_path: Path) -> None:
    old = Session(session.id, session.name, session.created_at, session.files, session.preflight)
    assert execution.run_chunk(work(old, artifacts, tmp_path)).content


def test_proxy_is_result_file_of_its_camera(session: Session, artifacts: LocalArtifacts, tmp_path: Path) -> None:
    frames: list[None] = []
    chunk = work(session, artifacts, tmp_path, lambda: frames.append(None))
    claim = replace(chunk.claim, stage="make_proxy", payload={**chunk.claim.payload, "camera": "right"})
    outcome = execution.run_chunk(replace(chunk, claim=replace(claim, making=ProxyChoices(("right",)))))
    (file,) = outcome.files
    assert (file.name, file.kind, file.person, file.media_type) == ("proxy-1.mp4", "proxy", None, "video/mp4")
    proxy = probe(file.path)
    assert isinstance(proxy, VideoInfo)
    assert (proxy.num_frames, len(frames)) == (NUM_FRAMES, NUM_FRAMES)
