"""One verdict: errors of the check refuse a session before people are associated, unless it is forced or mended."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import SessionRefused
from pipeline.core.findings import Finding, SessionCheck
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.job_choices import VisualChoices
from pipeline.core.problems.finding_codes import CAMERA_DISAGREES, STATURE_OUT_OF_RANGE
from pipeline.core.progress import Progress
from pipeline.run.engine.local import reconstruct, reconstruct_to_files
from pipeline.run.engine.stage import CHECK, REFINE
from pipeline.run.session_check.verdict import judge, judge_refined
from pipeline.validation.evaluation.simulated import score_simulated
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.simulations import write_simulation

CONFIG = ReconstructionConfig(smoothing="none", exports=("csv",))
FORCED = replace(CONFIG, force=True)
REFINING = replace(CONFIG, refine_calibration="auto")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    folder = tmp_path_factory.mktemp("session")
    write_simulation(record(replace(find_scene("room"), duration_s=5.0), seed=9), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


def exchanged(session: KeypointSession) -> KeypointSession:
    first, second, *rest = session.cameras
    return replace(session, cameras=(replace(second, name=first.name), replace(first, name=second.name), *rest))


def turned(session: KeypointSession, degrees: float) -> KeypointSession:
    """The session with its second camera panned by an angle."""
    turn = np.concatenate([[0.0, np.radians(degrees), 0.0], np.zeros(4)])
    first, second, *rest = session.cameras
    return replace(session, cameras=(first, move_camera(second, turn), *rest))


def refused(session: KeypointSession, config: ReconstructionConfig, cache: Path | None = None) -> tuple[list[str], str]:
    """Codes of the errors with which a session is refused, and the last stage that was begun."""
    steps: list[Progress] = []
    with pytest.raises(SessionRefused) as refusal:
        reconstruct(session, config, steps.append, cache)
    assert "force" in str(refusal.value)
    return [problem.code for problem in refusal.value.problems], steps[-1].stage if steps else ""


def metrics_of(session: KeypointSession, folder: Path, config: ReconstructionConfig) -> dict[str, object]:
    reconstruct_to_files(session, folder, config)
    metrics: dict[str, object] = json.loads((folder / "metrics.json").read_bytes())
    return metrics


def test_all_errors_refuse_session_before_people_are_associated(session: KeypointSession) -> None:
    assert refused(exchanged(session), CONFIG) == (["cameras_exchanged"] * 2, CHECK)
    assert refused(exchanged(session), replace(CONFIG, method="clustering"))[1] == CHECK


@pytest.mark.slow
def test_forced_session_goes_on_and_its_metrics_say_so(session: KeypointSession, tmp_path: Path) -> None:
    metrics = metrics_of(exchanged(session), tmp_path, FORCED)
    assert metrics["forced"] == ["cameras_exchanged"]
    checks = metrics["session_checks"]
    assert isinstance(checks, list)
    assert [check["severity"] for check in checks if check["code"] == "cameras_exchanged"] == ["error"] * 2


def test_refused_session_leaves_no_folder_of_results(session: KeypointSession, tmp_path: Path) -> None:
    with pytest.raises(SessionRefused):
        reconstruct_to_files(exchanged(session), tmp_path / "new", CONFIG)
    assert not (tmp_path / "new").exists()
    kept = tmp_path / "kept"
    kept.mkdir()
    with pytest.raises(SessionRefused):
        reconstruct_to_files(exchanged(session), kept, CONFIG)
    assert list(kept.iterdir()) == []


@pytest.mark.slow
def test_force_changes_nothing_without_errors(session: KeypointSession, tmp_path: Path) -> None:
    made = [reconstruct_to_files(session, tmp_path / name, config) for name, config in (("a", CONFIG), ("b", FORCED))]
    contents = [{path.name: path.read_bytes() for path in of_run.paths} for of_run in made]
    assert contents[0] == contents[1]
    assert b'"forced"' not in contents[0]["metrics.json"]


@pytest.mark.slow
def test_refused_session_is_refused_again_after_it_was_forced(session: KeypointSession, tmp_path: Path) -> None:
    reconstruct(exchanged(session), FORCED, cache=tmp_path)
    assert refused(exchanged(session), CONFIG, tmp_path)[1] == CHECK


def test_cameras_without_poses_are_refused_before_any_work(session: KeypointSession) -> None:
    pose = session.cameras[0].cam_from_world
    unposed = replace(session, cameras=tuple(replace(camera, cam_from_world=pose) for camera in session.cameras))
    assert refused(unposed, CONFIG) == (["calibration_unposed"], "")


@pytest.mark.slow
def test_error_mended_by_refinement_lets_job_run(session: KeypointSession) -> None:
    bumped = turned(session, 3.0)
    assert refused(bumped, CONFIG) == (["camera_disagrees"], CHECK)
    refinement = reconstruct(bumped, REFINING).refinement
    assert refinement is not None
    assert refinement.refined
    assert refinement.moved[0].rotation_deg > 1.0


@pytest.mark.slow
def test_error_that_refinement_leaves_refuses_job_after_it(session: KeypointSession) -> None:
    assert refused(turned(session, 40.0), REFINING) == (["camera_disagrees"], REFINE)


def test_error_beyond_refinement_refuses_job_before(session: KeypointSession) -> None:
    assert refused(exchanged(session), REFINING) == (["cameras_exchanged"] * 2, CHECK)


ERROR = Finding(CAMERA_DISAGREES, "The camera sees people elsewhere.", "a", "error", "Calibrate it again.")
CHECKED = SessionCheck((ERROR,), {"a": 12}, 12, 20)


def test_work_on_results_that_are_there_is_not_refused(session: KeypointSession) -> None:
    edited = replace(CONFIG, is_remade=True)
    assert judge(CHECKED, session.cameras, edited) == CHECKED
    assert judge(CHECKED, session.cameras, replace(CONFIG, making=VisualChoices())) == CHECKED
    with pytest.raises(SessionRefused):
        judge(CHECKED, session.cameras, CONFIG)


def test_problems_have_words_of_findings(session: KeypointSession) -> None:
    unit = Finding(STATURE_OUT_OF_RANGE, "People are 5.6 m tall.", None, "error", "State the unit.")
    both = replace(CHECKED, findings=(ERROR, unit, replace(ERROR, camera="b", severity="warning")))
    for config in (CONFIG, REFINING):
        with pytest.raises(SessionRefused) as refusal:
            judge(both, session.cameras, config)
        said = [(problem.code, problem.camera, problem.message, problem.hint) for problem in refusal.value.problems]
        assert said == [(finding.code, finding.camera, finding.message, finding.hint) for finding in (ERROR, unit)]
    with pytest.raises(SessionRefused, match="Refinement did not mend it"):
        judge_refined(CHECKED, session.cameras)


def eleven() -> Simulation:
    """Eleven cameras around two people, cam1 to cam11."""
    walk = find_scene("walk")
    scene = replace(walk, rig=replace(walk.rig, num_cameras=11), duration_s=4.0)
    simulation = record(scene, seed=12)
    names = {camera.name: f"cam{number}" for number, camera in enumerate(simulation.cameras, 1)}
    return replace(
        simulation,
        cameras=tuple(replace(camera, name=names[camera.name]) for camera in simulation.cameras),
        times={names[name]: times for name, times in simulation.times.items()},
        detections={names[name]: replace(seen, camera=names[name]) for name, seen in simulation.detections.items()},
    )


@pytest.mark.slow
def test_cameras_in_alphabetical_order_are_refused(tmp_path: Path) -> None:
    simulation = eleven()
    write_simulation(simulation, tmp_path)
    files = tmp_path / "keypoints", tmp_path / "calibration.json", tmp_path / "timestamps.csv"
    right = open_keypoints(*files)
    scores = score_simulated(reconstruct(right, CONFIG).tracks, simulation, simulation.joints)
    assert scores["mpjpe_mm"] < 20.0
    assert scores["ghost_rate"] == 0.0
    names = [camera.name for camera in right.cameras]
    wrong = replace(right, cameras=_paired(right.cameras, sorted(names), sorted(names, key=lambda name: int(name[3:]))))
    codes, stage = refused(wrong, CONFIG)
    # cam1 alone has the same place in both orders.
    assert (codes, stage) == (["cameras_exchanged"] * 10, CHECK)


def _paired(cameras: Sequence[Camera], files: Sequence[str], entries: Sequence[str]) -> tuple[Camera, ...]:
    """Cameras of which each has the calibration of the entry that stands where its file does."""
    by_name = {camera.name: camera for camera in cameras}
    entry_of = dict(zip(files, entries, strict=True))
    return tuple(replace(by_name[entry_of[camera.name]], name=camera.name) for camera in cameras)
