"""The stage ``refine``: calibrations that are off, reports, result files and the cut into chunks."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.calibration.registry import read_calibration
from pipeline.calibration.similarity import align_world, shift_m, turn_deg
from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.data.cameras import Camera, CameraBump, CameraMove, RefinedCalibration, Refinement, WorldMove
from pipeline.core.data.detections import PafFields
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import COCO_18
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.progress import Progress
from pipeline.core.runtime.record_archive import decode, encode
from pipeline.export.quality.report import quality_report
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.run.engine.methods import Association
from pipeline.run.engine.recalibration import refine_from_bodies, refine_from_fields
from pipeline.run.engine.stage import ASSOCIATE, REFINE
from pipeline.validation.evaluation.camera_errors import camera_errors, disturb_calibration
from pipeline.validation.simulation.scenes import find_scene, record
from pipeline.validation.simulation.views.fields import GRID, render
from pipeline.video.timeline import span_s
from tests.pipeline.simulations import write_simulation

CONFIG = ReconstructionConfig(refine_calibration="auto", smoothing="none", exports=("csv",))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    folder = tmp_path_factory.mktemp("session")
    write_simulation(record(replace(find_scene("room"), duration_s=6.0), seed=2), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


@pytest.fixture(scope="module")
def disturbed(session: KeypointSession) -> KeypointSession:
    """The session with every camera turned by a degree."""
    rng = np.random.default_rng(0)
    cameras = []
    for camera in session.cameras:
        axis = rng.normal(size=3)
        turn = np.radians(1.0) * axis / np.linalg.norm(axis)
        cameras.append(move_camera(camera, np.concatenate([turn, np.zeros(4)])))
    return replace(session, cameras=tuple(cameras))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Outputs of the stages of ``refined``."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def refined(disturbed: KeypointSession, cache: Path) -> Reconstruction:
    return reconstruct(disturbed, CONFIG, cache=cache)


def furthest(true: Sequence[Camera], found: Sequence[Camera]) -> tuple[float, float]:
    pairs = list(zip(true, align_world(true, found), strict=True))
    return max(turn_deg(*pair) for pair in pairs), max(shift_m(*pair) for pair in pairs)


@pytest.mark.slow
def test_disturbed_calibration_is_refined_reported_and_written(
    session: KeypointSession, disturbed: KeypointSession, refined: Reconstruction, tmp_path: Path
) -> None:
    given = reconstruct(disturbed, replace(CONFIG, refine_calibration="off", force=True))
    assert refined.refinement is not None
    assert refined.refinement.refined
    assert furthest(session.cameras, disturbed.cameras)[0] > 0.5
    far_deg, far_m = furthest(session.cameras, refined.cameras)
    assert far_deg < 0.5 * furthest(session.cameras, disturbed.cameras)[0]
    assert far_m < 0.02
    errors_px = [quality_report(one)["reprojection_error_px"]["median"] for one in (given, refined)]
    assert errors_px[1] < 0.6 * errors_px[0]
    paths = {path.name: path for path in write_results(refined, tmp_path, ["csv"])}
    written = read_calibration(paths["calibration.json"])
    for camera, other in zip(refined.cameras, written, strict=True):
        assert (camera.matrix == other.matrix).all()
        np.testing.assert_allclose(camera.cam_from_world.matrix, other.cam_from_world.matrix, atol=1e-12)
    metrics = json.loads(paths["metrics.json"].read_bytes())
    assert metrics["calibration"]["refined"]
    assert {move["camera"] for move in metrics["calibration"]["moved"]} == {camera.name for camera in written}
    assert "calibration_refined" in {check["code"] for check in metrics["capture_checks"]}


@pytest.mark.slow
def test_good_calibration_refined_gives_same_files(session: KeypointSession, tmp_path: Path) -> None:
    off, auto = (reconstruct(session, replace(CONFIG, refine_calibration=choice)) for choice in ("off", "auto"))
    assert auto.refinement is not None
    assert not auto.refinement.refined
    names = []
    for name, one in (("off", off), ("auto", auto)):
        names.append([path.name for path in write_results(one, tmp_path / name, ["csv"])])
    assert names[0] == names[1]
    for name in set(names[0]) - {"metrics.json"}:
        assert (tmp_path / "off" / name).read_bytes() == (tmp_path / "auto" / name).read_bytes()
    assert quality_report(off)["calibration"] is None
    assert quality_report(auto)["calibration"]["moved"] == []


@pytest.mark.slow
def test_tilted_world_is_levelled_reported_and_written(session: KeypointSession, tmp_path: Path) -> None:
    """Cameras agree with each other, so that none moves among them: the world alone does."""
    turn = Rotation.from_rotvec(np.radians([0.0, 6.0, 0.0])).as_matrix()
    tilted_from_true = Rigid3(turn, np.array([0.0, 0.0, 0.3]))
    cameras = [replace(one, cam_from_world=one.cam_from_world @ tilted_from_true.inverse()) for one in session.cameras]
    tilted = replace(session, cameras=tuple(cameras))
    levelled = reconstruct(tilted, CONFIG)
    report = quality_report(levelled)
    assert report["world_checks"] == []
    assert [check["code"] for check in report["capture_checks"]] == ["calibration_kept", "world_leveled"]
    calibration = report["calibration"]
    assert (calibration["refined"], calibration["moved"]) == (False, [])
    assert calibration["world"]["tilt_deg"] == pytest.approx(6.0, abs=0.5)
    assert calibration["world"]["height_m"] == pytest.approx(0.3, abs=0.05)
    written = {path.name: path for path in write_results(levelled, tmp_path, ["csv"])}["calibration.json"]
    for true, now in zip(session.cameras, read_calibration(written), strict=True):
        level_from_true = now.cam_from_world.inverse() @ true.cam_from_world
        assert np.degrees(np.arccos(level_from_true.rotation[2, 2])) < 0.5
        assert abs(level_from_true.translation_m[2]) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "seed"), [("room", 1), ("comings-and-goings", 1)])
def test_disturbed_cameras_in_tilted_world_come_back(scene: str, seed: int) -> None:
    """Cameras turned by a degree and shifted by 2 cm, in a world tilted by 5.8 degrees and lifted by 0.3 m."""
    simulation = record(replace(find_scene(scene), duration_s=20.0), seed)
    turn = Rotation.from_rotvec(np.radians([5.0, -3.0, 0.0])).as_matrix()
    true_from_tilted = Rigid3(turn, np.array([0.0, 0.0, 0.3])).inverse()
    tilted = [replace(one, cam_from_world=one.cam_from_world @ true_from_tilted) for one in simulation.cameras]
    given = disturb_calibration(replace(simulation, cameras=tuple(tilted)), 1.0, 0.02, seed).cameras
    detections, joints = simulation.detections, simulation.joints
    association = Association(given, simulation.times, simulation.timebase, joints, CONFIG)
    cameras, report = refine_from_bodies(association, detections, joints)
    assert report.world is not None
    errors = camera_errors(simulation.cameras, cameras)
    assert errors["rotation_deg"] <= 0.2
    assert errors["translation_mm"] <= 15.0
    for true, now in zip(simulation.cameras, cameras, strict=True):
        level_from_true = now.cam_from_world.inverse() @ true.cam_from_world
        assert np.degrees(np.arccos(level_from_true.rotation[2, 2])) < 0.3
        assert abs(level_from_true.translation_m[2]) < 0.03


@pytest.mark.slow
def test_refinement_is_reused_whatever_cut(disturbed: KeypointSession, refined: Reconstruction, cache: Path) -> None:
    seen: list[Progress] = []
    other = reconstruct(disturbed, replace(CONFIG, smoothing="butterworth"), seen.append, cache=cache)
    assert {one.stage for one in seen if one.reused == one.total} >= {REFINE, ASSOCIATE}
    cut = reconstruct(disturbed, replace(CONFIG, chunk_frames=7))
    for camera, same, again in zip(refined.cameras, other.cameras, cut.cameras, strict=True):
        assert (camera.cam_from_world.matrix == same.cam_from_world.matrix).all()
        assert (camera.cam_from_world.matrix == again.cam_from_world.matrix).all()


def test_reports_come_back_from_their_bytes(session: KeypointSession) -> None:
    report = Refinement(
        True,
        7.25,
        3.5,
        4000,
        (CameraMove("a", 1.5, 0.02, 1.001, 12.5),),
        (CameraBump("b", 134.2, 0.9),),
        WorldMove(4.5, -0.26),
        most_moved=CameraMove("a", 1.5, 0.02, 1.001, 12.5),
    )
    content = encode(RefinedCalibration(session.cameras, report))
    cameras, found = decode(RefinedCalibration, content)
    assert found == report
    assert content == encode(RefinedCalibration(cameras, found))
    assert [camera.name for camera in cameras] == [camera.name for camera in session.cameras]
    for ours, theirs in zip(session.cameras, cameras, strict=True):
        assert (theirs.size_px, theirs.section, theirs.lens) == (ours.size_px, ours.section, ours.lens)
        for name in ("matrix", "distortion"):
            np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
        np.testing.assert_array_equal(theirs.cam_from_world.matrix, ours.cam_from_world.matrix)


@pytest.mark.slow
def test_disturbed_calibration_is_refined_from_fields() -> None:
    simulation = record(replace(find_scene("room"), duration_s=4.0), seed=2)
    disturbed = disturb_calibration(simulation, 1.0, 0.0, seed=1)

    def chunks() -> Iterator[tuple[range, Mapping[str, PafFields]]]:
        for start in range(0, simulation.timebase.num_frames, 25):
            frames = range(start, min(start + 25, simulation.timebase.num_frames))
            span = span_s(simulation.timebase, frames.start, frames.stop)
            yield frames, render(simulation.sketches, simulation.times, span)

    config = ReconstructionConfig(
        "clustering", "openpose-mobilenet-thin", refine_calibration="auto", clustering={"tau2": GRID.tau2}
    )
    association = Association(disturbed.cameras, simulation.times, simulation.timebase, COCO_18, config, True)
    shares: list[float] = []
    cameras, report = refine_from_fields(association, chunks, shares.append)
    assert report.refined
    assert report.error_after_px < 0.6 * report.error_before_px
    given, refined = (camera_errors(simulation.cameras, some) for some in (disturbed.cameras, cameras))
    assert refined["rotation_deg"] < 0.6 * given["rotation_deg"]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
