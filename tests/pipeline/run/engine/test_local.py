"""The executor of one machine: reuse of finished tasks, and the same result whatever the processes."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import InputError
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.progress import Progress
from pipeline.core.runtime import large_arrays
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct, reconstruct_to_files
from pipeline.run.engine.plan import STAGE_BY_NAME
from pipeline.run.engine.stage import ASSOCIATE, CHECK, FIT, HOLD, IDENTIFY, LENGTHS, POSES
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation

TRACKING = ReconstructionConfig(exports=("bvh", "csv"))
CLUSTERING = replace(TRACKING, method="clustering", chunk_frames=20, smoothing="butterworth")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    folder = tmp_path_factory.mktemp("session")
    simulation = record(replace(find_scene("room"), duration_s=3.0), seed=6)
    write_simulation(simulation, folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


def written(reconstruction: Reconstruction, folder: Path) -> dict[str, bytes]:
    paths = write_results(reconstruction, folder, TRACKING.exports)
    return {path.name: path.read_bytes() for path in paths}


def reused(steps: Sequence[Progress]) -> dict[str, tuple[int, int]]:
    """Reused units and all units of each stage, at its end."""
    last = {step.stage: step for step in steps}
    assert all(step.done == step.total for step in last.values())
    return {name: (step.reused, step.total) for name, step in last.items()}


def run(session: KeypointSession, config: ReconstructionConfig, cache: Path | None) -> tuple[Reconstruction, Any]:
    steps: list[Progress] = []
    reconstruction = reconstruct(session, config, steps.append, cache)
    return reconstruction, reused(steps)


def test_another_smoothing_reuses_tracks(session: KeypointSession, tmp_path: Path) -> None:
    first, of_first = run(session, TRACKING, tmp_path / "cache")
    assert {units for units, _ in of_first.values()} == {0}
    again, of_again = run(session, TRACKING, tmp_path / "cache")
    assert all(units == total for units, total in of_again.values())
    assert written(again, tmp_path / "again") == written(first, tmp_path / "first")
    smoothed = replace(TRACKING, smoothing="one-euro")
    other, of_other = run(session, smoothed, tmp_path / "cache")
    assert of_other[ASSOCIATE][0] == of_other[ASSOCIATE][1]
    assert (of_other[FIT][0], of_other[HOLD][0]) == (0, 0)
    fresh, _ = run(session, smoothed, None)
    assert written(other, tmp_path / "other") == written(fresh, tmp_path / "fresh")


def test_arrays_in_files_change_no_byte(
    session: KeypointSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_memory = reconstruct_to_files(session, tmp_path / "memory", TRACKING)
    monkeypatch.setattr(large_arrays, "MIN_BYTES", 1)
    monkeypatch.setattr(large_arrays, "MAX_HELD_BYTES", 0)
    in_files = reconstruct_to_files(session, tmp_path / "files", TRACKING)
    assert [path.name for path in in_files.paths] == [path.name for path in in_memory.paths]
    for path in in_files.paths:
        assert path.read_bytes() == (tmp_path / "memory" / path.name).read_bytes(), path.name


@pytest.mark.slow
def test_paths_may_be_texts(session: KeypointSession, tmp_path: Path) -> None:
    cache, steps = str(tmp_path / "cache"), list[Progress]()
    first = reconstruct(session, TRACKING, cache=cache)
    made = reconstruct_to_files(session, str(tmp_path / "made"), TRACKING, steps.append, cache, sources=[__file__])
    assert reused(steps)[FIT][0] > 0
    assert {path.parent for path in made.paths} == {tmp_path / "made"}
    written_later = write_results(first, str(tmp_path / "written"), TRACKING.exports)
    assert {path.parent for path in written_later} == {tmp_path / "written"}


@pytest.mark.slow
def test_leftovers_beside_results_are_removed(session: KeypointSession, tmp_path: Path) -> None:
    cache, out = tmp_path / "cache", tmp_path / "out"
    reconstruct_to_files(session, out, TRACKING, cache=cache)
    files = {path.name for path in out.iterdir()}
    for name in (".new-killed", ".new-at-work"):
        (out / name).mkdir()
        (out / name / "person-1.bvh").write_bytes(b"half")
    with FileLock(out / ".new-at-work" / "lock"):
        reconstruct_to_files(session, out, TRACKING, cache=cache)
    assert {path.name for path in out.iterdir()} == files | {".new-at-work"}
    assert (out / ".new-at-work" / "person-1.bvh").exists()


@pytest.mark.slow
def test_parameter_of_method_counts(session: KeypointSession, tmp_path: Path) -> None:
    run(session, TRACKING, tmp_path)
    _, units = run(session, replace(TRACKING, tracking={"alpha_3d_m": 0.3}), tmp_path)
    assert units[ASSOCIATE][0] == 0


@pytest.mark.slow
def test_another_session_reuses_nothing(session: KeypointSession, tmp_path: Path) -> None:
    run(session, TRACKING, tmp_path)
    camera = next(iter(session.detections))
    moved = replace(session.detections[camera], keypoints_px=session.detections[camera].keypoints_px + 0.5)
    _, units = run(replace(session, detections={**session.detections, camera: moved}), TRACKING, tmp_path)
    assert units[ASSOCIATE][0] == 0


@pytest.mark.slow
@pytest.mark.parametrize("frame_range", [(10, 55), None])
def test_processes_and_ranges_change_no_byte(
    session: KeypointSession, tmp_path: Path, frame_range: tuple[int, int] | None
) -> None:
    config = replace(CLUSTERING, frame_range=frame_range)
    one, units = run(session, config, None)
    assert list(units) == [CHECK, LENGTHS, POSES, ASSOCIATE, IDENTIFY, FIT, HOLD]
    two, _ = run(session, replace(config, processes=2, chunk_frames=13), None)
    assert written(one, tmp_path / "one") == written(two, tmp_path / "two")


@pytest.mark.slow
def test_damaged_output_is_computed_again(session: KeypointSession, tmp_path: Path) -> None:
    first, _ = run(session, TRACKING, tmp_path / "cache")
    for path in (tmp_path / "cache").iterdir():
        content = bytearray(path.read_bytes())
        if content:
            content[-1] ^= 1
            path.write_bytes(content)
    again, units = run(session, TRACKING, tmp_path / "cache")
    assert {number for number, _ in units.values()} == {0}
    assert written(again, tmp_path / "again") == written(first, tmp_path / "first")


def test_wrong_choices_are_refused_before_work(session: KeypointSession) -> None:
    steps: list[Progress] = []
    with pytest.raises(InputError, match="output frames 0 to"):
        reconstruct(session, replace(TRACKING, frame_range=(5, 100_000)), steps.append)
    with pytest.raises(InputError, match="tau2"):
        reconstruct(session, replace(TRACKING, clustering={"tau2": 0.2}), steps.append)
    assert not steps


def test_table_of_stages() -> None:
    names = list(STAGE_BY_NAME)
    for number, stage in enumerate(STAGE_BY_NAME.values()):
        assert set(stage.follows) <= set(names[:number])
        assert stage.label
