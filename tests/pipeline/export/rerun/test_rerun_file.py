"""Rerun recordings, read by Rerun's own reader."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rerun", reason="rerun-sdk is not installed (the extra `rerun`)")

from rerun.chunk import RrdReader

from pipeline.calibration.sizes import scaled
from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Observations
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import PipelineError
from pipeline.core.options.file_formats import Export
from pipeline.export.rerun import rerun_file
from pipeline.export.rerun.rerun_file import RecordedFootage, write_rerun
from pipeline.export.results import write_results
from pipeline.export.scene import color_rgb
from pipeline.motion.angles.compute import joint_angles
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.skeleton.model import forward_kinematics
from tests.pipeline.export.test_overlay import LARGE, NUM_FRAMES, OFFSET_S, RATE_HZ, runner, session_of, take_of
from tests.pipeline.export.test_results import take
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

TOLERANCE = 1e-6
RERUN: tuple[Export, ...] = ("rerun",)


def people() -> Reconstruction:
    """Somebody who is there from the start on, and somebody who comes later and is partly seen."""
    late_m = walker(40)
    late_m[5:9, 9] = np.nan
    return take(track_of(walker(60)), replace(track_of(late_m), track_id=2, start_frame=30))


@pytest.fixture(scope="module")
def whole() -> Reconstruction:
    return people()


@pytest.fixture(scope="module")
def path(whole: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "take.rrd"
    shares: list[float] = []
    write_rerun(whole, path, on_share=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert [found.name for found in path.parent.iterdir()] == [path.name]
    return path


def chunks(path: Path, entity: str, *, static: bool = False) -> Iterator[Any]:
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == f"/{entity}" and chunk.is_static == static:
            yield chunk.to_record_batch()


def fixed(path: Path, entity: str, component: str) -> Any:
    """Value of a component that has no time."""
    (found,) = (
        batch.column(component)[0].as_py()
        for batch in chunks(path, entity, static=True)
        if component in batch.schema.names
    )
    return found


def rows(path: Path, entity: str, component: str) -> dict[int, tuple[float, Any]]:
    """Times in seconds and values of a component by output frame."""
    found: dict[int, tuple[float, Any]] = {}
    for batch in chunks(path, entity):
        time_s = batch.column("time").cast("int64").to_numpy() / 1e9
        values = [value.as_py() for value in batch.column(component)]
        frames = batch.column("frame").to_numpy().tolist()
        assert not found.keys() & set(frames)
        found |= dict(zip(frames, zip(time_s.tolist(), values, strict=True), strict=True))
    return found


def joints_of(path: Path, entity: str, kind: str, num_joints: int, num_axes: int) -> dict[int, np.ndarray]:
    """Positions (joints, axes) by output frame, NaN where there are none."""
    ids = rows(path, entity, f"{kind}:keypoint_ids")
    found = {}
    for frame, (_, positions) in rows(path, entity, f"{kind}:positions").items():
        found[frame] = np.full((num_joints, num_axes), np.nan)
        if positions:
            found[frame][ids[frame][1]] = positions
    return found


def test_cameras_are_pinholes_at_their_places(path: Path, whole: Reconstruction) -> None:
    # Directions of x, y and z in Rerun's numbers.
    up, down, right, forward = 1, 2, 3, 5
    assert fixed(path, "world", "ViewCoordinates:xyz") == [[right, forward, up]]
    for camera in whole.cameras:
        entity = f"world/cameras/{camera.name}"
        rotation = np.reshape(fixed(path, entity, "Transform3D:mat3x3")[0], (3, 3)).T  # columns come first there
        translation_m = fixed(path, entity, "Transform3D:translation")[0]
        place = camera.cam_from_world.inverse()
        np.testing.assert_allclose(rotation, place.rotation, atol=TOLERANCE)
        np.testing.assert_allclose(translation_m, place.translation_m, atol=TOLERANCE)
        matrix = np.reshape(fixed(path, f"{entity}/image", "Pinhole:image_from_camera")[0], (3, 3)).T
        np.testing.assert_allclose(matrix, camera.matrix + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]), rtol=1e-6)
        assert fixed(path, f"{entity}/image", "Pinhole:resolution") == [list(camera.size_px)]
        assert fixed(path, f"{entity}/image", "Pinhole:camera_xyz") == [[right, down, forward]]


def test_people_are_where_they_are(path: Path, whole: Reconstruction) -> None:
    for track, located, motion, observations in zip(
        whole.tracks, whole.located, whole.motions, whole.observations, strict=True
    ):
        body, num_joints = f"world/people/person-{track.track_id}", len(whole.joints.names)
        ends = {track.frames.stop} & set(range(whole.timebase.num_frames))
        cases = [(f"{body}/located", "Points3D", located.xyz_m, TOLERANCE)]
        cases.append((f"{body}/skeleton", "Points3D", forward_kinematics(motion), TOLERANCE))
        for column, camera in enumerate(whole.cameras):
            seen = f"world/cameras/{camera.name}/image/person-{track.track_id}"
            # Numbers of single precision: a thousand pixels are a sixteen-thousandth off.
            cases.append((seen, "Points2D", observations.points_px[:, column] + 0.5, 1e-4))
        for entity, kind, expected, tolerance in cases:
            found = joints_of(path, entity, kind, expected.shape[1], expected.shape[2])
            assert set(found) == set(track.frames) | ends
            assert all(np.isnan(found[frame]).all() for frame in ends)
            np.testing.assert_allclose([found[frame] for frame in track.frames], expected, atol=tolerance)
            for frame, (time_s, _) in rows(path, entity, f"{kind}:positions").items():
                assert time_s == pytest.approx(whole.timebase.time_s(frame), abs=1e-8)
        context = fixed(path, f"{body}/located", "AnnotationContext:context")[0]
        (described,) = [entry["class_description"] for entry in context]
        assert described["info"]["label"] == motion.name
        assert described["info"]["color"] >> 8 == int.from_bytes(bytes(color_rgb(track.track_id)))
        assert [keypoint["label"] for keypoint in described["keypoint_annotations"]] == list(whole.joints.names)
        assert len(described["keypoint_connections"]) == len(whole.joints.bones)
        assert num_joints == len(described["keypoint_annotations"])


def test_angles_and_contacts_are_time_series(path: Path, whole: Reconstruction) -> None:
    for track, motion in zip(whole.tracks, whole.motions, strict=True):
        angles = joint_angles(motion, track, whole.joints, has_sigmas=False)
        for name, column in zip(ANGLE_NAMES, angles.angle_deg.T, strict=True):
            series = rows(path, f"angles/person-{track.track_id}/{name}", "Scalars:scalars")
            assert bool(series) == np.isfinite(column).any()
            if series:
                found_deg = [series[frame][1][0] for frame in track.frames]
                np.testing.assert_allclose(found_deg, column, atol=TOLERANCE)
        assert motion.contacts
        for contact in motion.contacts:
            series = rows(path, f"contacts/person-{track.track_id}/{contact.side}_{contact.part}", "Scalars:scalars")
            found = np.array([series[frame][1][0] for frame in motion.frames])
            assert (found[contact.rows] == contact.confidence).all()
            others = np.concatenate([np.r_[other.rows] for other in motion.contacts if other.side == contact.side])
            assert not found[np.setdiff1d(np.arange(len(found)), others)].any()


def test_pictures_and_unmatched_bodies_have_times_of_camera(tmp_path: Path) -> None:
    camera = replace(LARGE, name="front left/1")
    session = session_of(camera, tmp_path)
    timebase = Timebase(0.0, RATE_HZ, 40)
    track = runner()
    points_px = np.full((40, 1, 17, 2), np.nan)
    points_px[:, 0, 9] = (400.0, 300.0)
    observed = take_of(camera, timebase, track)
    motion = people().motions[0]
    turns = np.tile(motion.parent_from_joint[:1], (40, 1, 1))
    motion = replace(motion, track_id=3, root_m=np.zeros((40, 3)), parent_from_joint=turns, contacts=())
    observed = replace(
        observed,
        located=(track,),
        observations=(Observations(3, points_px, np.where(np.isfinite(points_px[..., 0]), 0.9, 0.0)),),
        animation=replace(observed.animation, motions=(motion,)),
    )
    keypoints_px = np.full((3, 17, 2), np.nan)
    keypoints_px[0, 9] = (403.0, 304.0)  # the person, five pixels away
    keypoints_px[1, [9, 10]] = ((900.0, 310.0), (920.0, 330.0))
    keypoints_px[2, 9] = (1200.0, 800.0)
    boxes_px = np.array([[350.0, 250.0, 450.0, 350.0]] * 3)
    detections = Detections("front left/1", np.array([4, 4, 6]), keypoints_px, np.ones((3, 17)), boxes_px)
    path = tmp_path / "take.rrd"
    write_rerun(observed, path, RecordedFootage(session, {"front left/1": detections}))

    image = "world/cameras/front\\ left\\/1/image"
    small = scaled(camera, (640, 480))
    matrix = np.reshape(fixed(path, image, "Pinhole:image_from_camera")[0], (3, 3)).T
    np.testing.assert_allclose(matrix[:2, 2] - 0.5, small.matrix[:2, 2], rtol=1e-6)
    assert fixed(path, image, "Pinhole:resolution") == [[640, 480]]
    pictures = rows(path, image, "EncodedImage:blob")
    # Half of the frames are at most ten a second, at 25 Hz every third one.
    assert [time_s for time_s, _ in pictures.values()] == pytest.approx(
        [OFFSET_S + number / RATE_HZ for number in (0, 3, 5, 8, 10)], abs=1e-6
    )
    for frame, (time_s, (blob,)) in pictures.items():
        assert frame == round(time_s * RATE_HZ)
        picture = cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        assert picture.shape == (480, 640, 3)
    assert [value for batch in chunks(path, image) for value in batch.column("EncodedImage:media_type")[0].as_py()] == [
        "image/jpeg"
    ]
    bodies = rows(path, f"{image}/nobody", "Points2D:positions")
    assert len(bodies) == NUM_FRAMES
    first = round((OFFSET_S + 4 / RATE_HZ) * RATE_HZ)
    np.testing.assert_allclose(bodies[first][1], (keypoints_px[1, [9, 10]] + 0.5) * 0.4, atol=1e-4)
    np.testing.assert_allclose(bodies[first + 2][1], (keypoints_px[2, [9]] + 0.5) * 0.4, atol=1e-4)
    assert [frame for frame, (_, found) in bodies.items() if found] == [first, first + 2]
    assert rows(path, f"{image}/nobody", "Points2D:keypoint_ids")[first][1] == [9, 10]
    np.testing.assert_allclose(
        joints_of(path, f"{image}/person-3", "Points2D", 17, 2)[20][9], (400.5 * 0.4, 300.5 * 0.4), atol=1e-4
    )


def test_far_worlds_have_origin_near_cameras(whole: Reconstruction, tmp_path: Path) -> None:
    away_m = np.array([500_123.0, 5_412_345.0, 312.0])
    cameras = tuple(
        replace(camera, cam_from_world=camera.cam_from_world @ Rigid3(np.eye(3), -away_m)) for camera in whole.cameras
    )
    motions = tuple(replace(motion, root_m=motion.root_m + away_m) for motion in whole.motions)
    far = replace(whole, cameras=cameras, animation=replace(whole.animation, motions=motions))
    write_rerun(far, tmp_path / "far.rrd")
    (batch,) = (
        chunk.to_record_batch()
        for chunk in RrdReader(tmp_path / "far.rrd").stream()
        if chunk.entity_path == "/__properties/take"
    )
    origin_m = np.array(batch.column("origin_m")[0].as_py()).reshape(3)
    assert np.linalg.norm(origin_m - away_m) < 10.0
    found = joints_of(
        tmp_path / "far.rrd", "world/people/person-1/skeleton", "Points3D", len(motions[0].bone_length_m), 3
    )
    np.testing.assert_allclose(
        [found[frame] + origin_m for frame in motions[0].frames], forward_kinematics(motions[0]), atol=1e-5
    )


def test_nobody(tmp_path: Path) -> None:
    write_rerun(take(), tmp_path / "take.rrd")
    assert fixed(tmp_path / "take.rrd", "world/cameras/a/image", "Pinhole:resolution") == [[1280, 720]]


def test_results_have_recording_beside_files_of_people(whole: Reconstruction, tmp_path: Path) -> None:
    names = [path.name for path in write_results(whole, tmp_path, ("csv", "rerun"))]
    assert sorted(name for name in names if not name.endswith("csv")) == ["metrics.json", "skeletons.json", "take.rrd"]
    assert sorted(names) == sorted(path.name for path in tmp_path.iterdir())


@pytest.mark.parametrize("fault", ["cut off", "empty", "another motion", "fewer frames"])
def test_recording_with_wrong_contents_is_error(
    whole: Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    write = rerun_file._Recorder.write

    def write_wrong(recorder: Any, *arguments: Any) -> None:
        motions = whole.motions
        if fault == "another motion":
            motions = tuple(replace(motion, root_m=motion.root_m + 2e-4) for motion in motions)
        if fault == "fewer frames":
            motions = tuple(_shortened(motion) for motion in motions)
        recorder._take = replace(whole, animation=replace(whole.animation, motions=motions))
        if fault == "fewer frames":
            monkeypatch.setattr(recorder, "_add_angles", lambda *_: None)
        write(recorder, *arguments)
        content = recorder._path.read_bytes()
        if fault in ("cut off", "empty"):
            recorder._path.write_bytes(content[: len(content) // 2] if fault == "cut off" else b"")

    monkeypatch.setattr(rerun_file._Recorder, "write", write_wrong)
    with pytest.raises(PipelineError, match=r"take\.rrd"):
        write_results(whole, tmp_path / "out", RERUN)
    assert list((tmp_path / "out").iterdir()) == []


def _shortened(motion: SkeletonMotion) -> SkeletonMotion:
    return replace(motion, root_m=motion.root_m[:-1], parent_from_joint=motion.parent_from_joint[:-1], contacts=())
