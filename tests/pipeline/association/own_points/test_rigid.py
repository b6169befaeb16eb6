"""Poses of rigid objects: of rackets that people hold, and of a box that flies."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.association.own_points.rigid import RigidMotion, poses, rigid_motions
from pipeline.core.data.own_points import RigidShape, columns_of
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.quality.report import quality_report
from pipeline.run.engine.local import reconstruct
from tests.pipeline.own_point_scenes import BOX, RACKET, OwnScene, rigid_scene, with_shapes

SHAPE = RigidShape("box", tuple(BOX), np.array(list(BOX.values())))
FRAMES = 40


@pytest.fixture(scope="module")
def scene() -> OwnScene:
    return rigid_scene(duration_s=1.5)


@pytest.fixture(scope="module")
def take(scene: OwnScene) -> Reconstruction:
    return reconstruct(with_shapes(scene.session), ReconstructionConfig(refine_calibration="off"))


def placed_m(motion: RigidMotion) -> np.ndarray:
    """Points of an object as its poses place them, NaN in frames without a pose."""
    turn = Rotation.from_quat(np.where(np.isnan(motion.quat_xyzw), [0.0, 0.0, 0.0, 1.0], motion.quat_xyzw)).as_matrix()
    placed: np.ndarray = np.einsum("fij,pj->fpi", turn, motion.shape.xyz_m) + motion.place_m[:, None]
    return placed


def test_box_of_distances_is_where_it_is(scene: OwnScene, take: Reconstruction) -> None:
    """The mirror image that distances leave open is told; a pose is more exact than its points."""
    (box,) = [motion for motion in rigid_motions(take.own) if motion.person is None]
    assert (box.name, box.shape.points, box.frames) == ("box", tuple(BOX), range(take.timebase.num_frames))
    truth_m = np.stack([scene.truth_m[name] for name in box.shape.points], axis=1)
    miss_m = np.linalg.norm(placed_m(box) - truth_m, axis=-1)
    (measured,) = [thing.track.xyz_m for thing in take.own.objects if thing.name == "box"]
    measured_rms_m = np.sqrt(np.nanmean(np.linalg.norm(measured - truth_m, axis=-1) ** 2))
    assert np.isfinite(miss_m).mean() > 0.95
    assert np.sqrt(np.nanmean(miss_m**2)) < 0.8 * measured_rms_m < 0.008
    assert 0.001 < np.nanmedian(box.rms_m) < 0.01


def test_box_of_places_has_its_axes(scene: OwnScene, take: Reconstruction) -> None:
    posed = reconstruct(with_shapes(scene.session, by_distances=False), ReconstructionConfig(refine_calibration="off"))
    (box,) = [motion for motion in rigid_motions(posed.own) if motion.person is None]
    assert scene.world_from_box is not None
    assert scene.box_m is not None
    known = np.isfinite(box.rms_m)
    between = (Rotation.from_quat(box.quat_xyzw[known]) * scene.world_from_box[known].inv()).magnitude()
    assert np.degrees(np.median(between)) < 1.5
    assert np.median(np.linalg.norm(box.place_m - scene.box_m, axis=1)[known]) < 0.01
    # The quaternion stays on one hemisphere, so that viewers may go from frame to frame.
    assert (np.einsum("fi,fi->f", box.quat_xyzw[1:], box.quat_xyzw[:-1])[known[1:] & known[:-1]] > 0).all()


def test_everybody_has_a_racket(scene: OwnScene, take: Reconstruction) -> None:
    assert set(take.own.names) == set(RACKET)
    assert take.own.bones == (("grip", "tip"),)
    rackets = [motion for motion in rigid_motions(take.own) if motion.person is not None]
    assert [racket.name for racket in rackets] == [f"person_{track.track_id}_racket" for track in take.tracks]
    assert scene.world_from_racket is not None
    people = set()
    for racket in rackets:
        rows = slice(racket.frames.start, racket.frames.stop)
        truth_m = np.stack([scene.truth_m[name][:, rows] for name in racket.shape.points], axis=2)
        miss_m = np.linalg.norm(placed_m(racket) - truth_m, axis=-1)
        person = int(np.nanmedian(miss_m, axis=(1, 2)).argmin())
        people.add(person)
        assert np.isfinite(miss_m[person]).mean() > 0.95
        assert np.sqrt(np.nanmean(miss_m[person] ** 2)) < 0.008
    assert people == {0, 1, 2}


def test_report_tells_poses_and_their_residuals(take: Reconstruction) -> None:
    (finding,) = [finding for finding in take.warnings if finding.message.startswith("Points of your own")]
    assert finding.message.endswith("tip, left, right, grip belong to people; box are objects.")
    report = quality_report(take)["rigid_objects"]
    assert [(each["name"], each["person"]) for each in report] == [
        *(("racket", track.track_id) for track in take.tracks),
        ("box", None),
    ]
    for each, motion in zip(report, rigid_motions(take.own), strict=True):
        assert each["coverage"] == pytest.approx(np.isfinite(motion.rms_m).mean(), abs=1e-4)
        assert each["rms_mm"] == pytest.approx(1000 * np.nanmedian(motion.rms_m), abs=0.01)


def test_object_of_another_size_has_no_pose(scene: OwnScene) -> None:
    session = with_shapes(scene.session)
    centimetres = tuple(shape._replace(xyz_m=100.0 * shape.xyz_m) for shape in session.own.shapes[1:])
    wrong = replace(session, own=replace(session.own, shapes=centimetres))
    take = reconstruct(wrong, ReconstructionConfig(refine_calibration="off"))
    assert not take.own.shapes
    report = quality_report(take)
    assert "rigid_objects" not in report
    (doubt,) = [check for check in report["capture_checks"] if check["code"] == "own_points_doubtful"]
    assert doubt["message"].startswith("box has no pose: at no time three of its points are located at the distances")


def track(xyz_m: np.ndarray, sigma_m: np.ndarray | float = 0.003) -> Track3D:
    known = np.isfinite(xyz_m).all(-1)
    zeros = np.zeros(known.shape)
    sigmas_m = np.where(known, sigma_m, np.nan)
    return Track3D(1, 5, xyz_m, zeros, known.astype(np.int8), zeros, zeros.astype(int), sigmas_m)


@pytest.fixture
def moved() -> tuple[Rotation, np.ndarray, np.ndarray]:
    """Rotations and places of the box, and its points."""
    random = np.random.default_rng(2)
    turn, place_m = Rotation.random(FRAMES, random_state=3), random.normal(0.0, 1.0, (FRAMES, 3))
    return turn, place_m, np.einsum("fij,pj->fpi", turn.as_matrix(), SHAPE.xyz_m) + place_m[:, None]


Moved = tuple[Rotation, np.ndarray, np.ndarray]


def test_exact_points_give_exact_poses(moved: Moved) -> None:
    turn, place_m, xyz_m = moved
    (motion,) = poses((SHAPE,), SHAPE.points, track(xyz_m))
    assert motion.frames == range(5, 5 + FRAMES)
    np.testing.assert_allclose(motion.place_m, place_m, atol=1e-9)
    np.testing.assert_allclose(Rotation.from_quat(motion.quat_xyzw).as_matrix(), turn.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(motion.rms_m, 0.0, atol=1e-9)
    assert (motion.num_points == 4).all()


def test_point_elsewhere_is_left_out(moved: Moved) -> None:
    _, place_m, xyz_m = moved
    xyz_m[:, 2] += [0.7, -0.4, 0.2]
    (motion,) = poses((SHAPE,), SHAPE.points, track(xyz_m))
    assert (motion.num_points == 3).all()
    np.testing.assert_allclose(motion.place_m, place_m, atol=1e-9)


def test_uncertain_point_counts_less(moved: Moved) -> None:
    _, place_m, xyz_m = moved
    xyz_m[:, 1] += [0.0, 0.0, 0.03]
    alike, apart = (
        poses((SHAPE,), SHAPE.points, track(xyz_m, sigma_m))[0]
        for sigma_m in (0.01, np.array([0.003, 0.03, 0.003, 0.003]))
    )
    misses_m = [np.linalg.norm(motion.place_m - place_m, axis=1).mean() for motion in (alike, apart)]
    assert misses_m[1] < 0.2 * misses_m[0]


def test_gap_and_two_points_have_no_pose(moved: Moved) -> None:
    _, _, xyz_m = moved
    xyz_m[3:6] = np.nan
    xyz_m[8, :2] = np.nan
    (motion,) = poses((SHAPE,), SHAPE.points, track(xyz_m))
    assert np.flatnonzero(np.isnan(motion.rms_m)).tolist() == [3, 4, 5, 8]
    assert np.flatnonzero(motion.num_points == 0).tolist() == [3, 4, 5, 8]
    assert np.isnan(motion.quat_xyzw[[3, 4, 5, 8]]).all()
    assert np.isnan(motion.place_m[[3, 4, 5, 8]]).all()


def test_points_on_a_line_tell_no_pose(moved: Moved) -> None:
    line = RigidShape("rod", ("a", "b", "c", "d"), np.array([[0.0, 0, 0], [0, 0, 0.3], [0, 0, 0.6], [0.2, 0, 0]]))
    turn, place_m, _ = moved
    xyz_m = np.einsum("fij,pj->fpi", turn.as_matrix(), line.xyz_m) + place_m[:, None]
    xyz_m[4, 3] = np.nan
    (motion,) = poses((line,), line.points, track(xyz_m))
    assert np.flatnonzero(np.isnan(motion.rms_m)).tolist() == [4]


def test_objects_of_other_points_are_left_out(moved: Moved) -> None:
    _, _, xyz_m = moved
    part = columns_of(track(xyz_m), [0, 1, 2])
    assert poses((SHAPE,), SHAPE.points[:3], part) == ()
