"""Foreseen space against what a reconstruction writes, and what it depends on."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from api.cli.space import require_space, session_space
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.preflight import report
from pipeline.capture.preflight_record import Preflight
from pipeline.core.data.cameras import Timebase
from pipeline.core.errors import InputError
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.file_formats import FILE_FORMATS, Export, formats_of_people, installed_formats
from pipeline.run.engine.local import reconstruct_to_files
from pipeline.run.space import (
    CameraFrames,
    ForeseenSpace,
    estimate_space,
    foreseen_memory,
    foreseen_space,
    memory_of_people,
    shown_bytes,
)
from pipeline.validation.simulation.scenes import SCENES, record
from worker.run.settings import WorkerSettings

MAX_RATIO = 1.5
MIN_RATIO = 0.7


@pytest.fixture(scope="module")
def session() -> KeypointSession:
    simulation = record(replace(SCENES["room"], duration_s=3.0), 0, 4)
    timebase = Timebase(0.0, simulation.timebase.frame_rate_hz, simulation.timebase.num_frames)
    return KeypointSession(
        simulation.cameras, simulation.times, timebase, simulation.detections, simulation.joints, {}, ()
    )


def preflight_of(session: KeypointSession) -> Preflight:
    return report(session, [[f"{camera.name}.zip"] for camera in session.cameras], None)


def of_videos(config: ReconstructionConfig, num_frames: int = 18_000) -> ForeseenSpace:
    cameras = [CameraFrames((3840, 2160), num_frames) for _ in range(8)]
    return estimate_space(cameras, num_frames, 30.0, (range(num_frames),), config, has_viewers=True)


def num_bytes(paths: Iterable[Path]) -> int:
    return sum(path.stat().st_size for path in paths if path.is_file())


def test_reconstruction_writes_about_what_is_foreseen(session: KeypointSession, tmp_path: Path) -> None:
    formats = formats_of_people(installed_formats())
    config = ReconstructionConfig(exports=formats)
    foreseen = session_space(session, config)
    written = reconstruct_to_files(session, tmp_path / "results", config, cache=tmp_path / "cache")
    assert len(written.metrics["people"]) == foreseen.num_people == 3
    assert MIN_RATIO < foreseen.output_bytes / num_bytes((tmp_path / "cache").iterdir()) < MAX_RATIO
    assert MIN_RATIO < foreseen.result_bytes / num_bytes(written.paths) < MAX_RATIO


@pytest.mark.parametrize("export", formats_of_people(FILE_FORMATS))
def test_every_format_is_counted(export: Export) -> None:
    without = of_videos(ReconstructionConfig(exports=())).result_bytes
    assert of_videos(ReconstructionConfig(exports=(export,))).result_bytes > 1.1 * without


def test_record_of_session_says_as_much_as_session(session: KeypointSession) -> None:
    preflight = Preflight.from_json(json.loads(json.dumps(preflight_of(session).to_json())))
    config = ReconstructionConfig(exports=("bvh",))
    of_record, of_session = foreseen_space(preflight, config), session_space(session, config)
    assert of_record.num_people == of_session.num_people
    # The service writes the files for viewers beside the others, and keeps copies of all for edits.
    assert of_record.result_bytes > of_session.result_bytes
    copies_bytes = of_record.output_bytes - of_session.output_bytes
    assert abs(copies_bytes - of_record.result_bytes) <= 1


def test_space_depends_on_choices() -> None:
    plain = of_videos(ReconstructionConfig())
    assert plain.num_people == 3
    assert 1.9 < of_videos(ReconstructionConfig(), 36_000).store_bytes / plain.store_bytes < 2.1
    shorter = of_videos(ReconstructionConfig(frame_range=(0, 1_800)))
    assert 0.09 < shorter.output_bytes / plain.output_bytes < 0.11
    assert of_videos(ReconstructionConfig(people=1)).store_bytes < 0.5 * plain.store_bytes
    assert of_videos(ReconstructionConfig(people=8)).num_people == 3
    for more in (
        ReconstructionConfig(overlay=True),
        ReconstructionConfig(report=True),
        ReconstructionConfig(joints="whole"),
        ReconstructionConfig(exports=("bvh", "rerun")),
        ReconstructionConfig(blurs_videos=True),
        ReconstructionConfig(method="clustering", detector="openpose-mobilenet-thin"),
    ):
        assert of_videos(more).store_bytes > 1.01 * plain.store_bytes
    assert plain.scratch_bytes > plain.result_bytes


def test_disk_without_space_is_refused_before_any_work(tmp_path: Path) -> None:
    needed = ForeseenSpace(output_bytes=0, result_bytes=2**60, scratch_bytes=0, num_people=3)
    with pytest.raises(InputError) as refused:
        require_space(needed, tmp_path / "not" / "there", None)
    (problem,) = refused.value.problems
    assert problem.code == "space_missing"
    assert str(tmp_path) in problem.message
    assert "1073741824.0 GiB" in problem.message
    assert "--out" in str(problem.hint)
    require_space(replace(needed, result_bytes=1), tmp_path, tmp_path)


@pytest.mark.parametrize(("num_bytes", "shown"), [(0, "0.0 KiB"), (2**20, "1.0 MiB"), (3 * 2**29, "1.5 GiB")])
def test_amounts_in_words(num_bytes: int, shown: str) -> None:
    assert shown_bytes(num_bytes) == shown


def test_hour_of_twelve_cameras_and_four_people_fits_worker() -> None:
    num_people = 4 * 3600 * 60
    foreseen = memory_of_people(12 * 17 * num_people, num_people, 17)
    assert 2**31 < foreseen < WorkerSettings.model_fields["memory_bytes"].default - 300 * 2**20
    # Half an hour has as much in small arrays as an hour.
    assert memory_of_people(6 * 17 * num_people, num_people / 2, 17) == (foreseen + 2**28) / 2


def test_memory_of_whole_tasks_grows_with_joints(session: KeypointSession) -> None:
    preflight = preflight_of(session)
    num_joints = sum(detections.score.size for detections in session.detections.values())
    memory = foreseen_memory(preflight, ReconstructionConfig())
    num_people = max(len(detections.frame) for detections in session.detections.values())
    assert memory.whole_bytes == 300 * 2**20 + 73 * num_joints + 6_500 * num_people
    # Every task on keypoints holds all of them; of videos only those on the whole session do.
    assert {memory.task_bytes(cut) for cut in ("ranges", "whole", "people")} == {memory.whole_bytes}
    uncounted = [replace(camera, num_bodies=None, num_joints=None) for camera in preflight.cameras]
    of_videos = replace(preflight, cameras=tuple(uncounted))
    memory = foreseen_memory(of_videos, ReconstructionConfig())
    assert memory.task_bytes("camera ranges") == 300 * 2**20 < memory.task_bytes("whole")
    half = ReconstructionConfig(frame_range=(0, preflight.timebase.num_frames // 2))
    assert foreseen_memory(of_videos, half).whole_bytes < memory.whole_bytes
