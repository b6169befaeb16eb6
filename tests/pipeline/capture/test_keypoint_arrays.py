"""Sessions from arrays: the session of the same keypoints in files, and a sentence for each wrong argument."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from multicap import Camera, InputError, KeypointSession, Rigid3, Session, open_keypoints
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    folder = tmp_path_factory.mktemp("capture")
    write_simulation(record(replace(find_scene("room"), duration_s=0.8), 0, 3), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)


def arrays_of(session: KeypointSession) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Keypoints and scores of each camera by frame and person."""
    keypoints_px, scores = {}, {}
    for name, detections in session.detections.items():
        num_people = np.bincount(detections.frame).max()
        shape = len(session.times[name].time_s), num_people, len(session.joints.names)
        keypoints_px[name], scores[name] = np.full((*shape, 2), np.nan), np.zeros(shape)
        for frame in range(shape[0]):
            rows = detections.frame == frame
            keypoints_px[name][frame, : rows.sum()] = detections.keypoints_px[rows]
            scores[name][frame, : rows.sum()] = detections.score[rows]
    return keypoints_px, scores


def test_arrays_give_session_of_files(opened: KeypointSession) -> None:
    keypoints_px, scores = arrays_of(opened)
    session = Session.from_arrays(keypoints_px, scores, opened.cameras, 25.0, joints=opened.joints.names)
    assert asdict(session.timebase) == asdict(opened.timebase)
    assert session.joints == opened.joints
    for name, detections in opened.detections.items():
        np.testing.assert_array_equal(session.detections[name].frame, detections.frame)
        np.testing.assert_array_equal(session.detections[name].keypoints_px, detections.keypoints_px)
        np.testing.assert_array_equal(session.detections[name].score, detections.score)


def test_times_of_cameras_give_clock(opened: KeypointSession) -> None:
    keypoints_px, _ = arrays_of(opened)
    times_s = {name: 0.01 * k + camera_times.time_s for k, (name, camera_times) in enumerate(opened.times.items())}
    session = Session.from_arrays(keypoints_px, None, opened.cameras, times_s=times_s)
    assert session.timebase.frame_rate_hz == pytest.approx(25.0)
    np.testing.assert_array_equal(session.times[opened.cameras[2].name].time_s, times_s[opened.cameras[2].name])
    assert all(
        (detections.score[np.isfinite(detections.keypoints_px).all(-1)] == 1).all()
        for detections in session.detections.values()
    )


def test_points_without_names_take_layout_of_their_number(opened: KeypointSession) -> None:
    keypoints_px, scores = arrays_of(opened)
    session = Session.from_arrays(list(keypoints_px.values()), list(scores.values()), opened.cameras, 25.0)
    assert session.layout is not None
    assert session.layout.name == "coco-17"


@pytest.mark.parametrize(
    ("changes", "sentences"),
    [
        ({"frame_rate_hz": None}, ["State frame_rate_hz, or times_s, and not both."]),
        ({"keypoints_px": [1.0, 2.0, 3.0]}, ["keypoints_px must be numbers of the shape"]),
        ({"keypoints_px": []}, ["keypoints_px must have an array for each of the 3 cameras."]),
        ({"keypoints_px": {"left": 0}}, ["keypoints_px has arrays of unknown cameras: left."]),
        ({"joints": ["nose"]}, ["joints has 1 names; keypoints_px has 17 points."]),
        ({"joints": "mine"}, ["joints must be one of coco-17, "]),
        ({"cameras": [3]}, ["cameras must be a list, each item a Camera, or a text, or a path, not [3]."]),
        ({"frame_rate_hz": None, "times_s": [0.0, 0.0]}, ["times_s must be 20 ascending times"]),
        ({"frame_rate_hz": 0.0}, ["A frame rate of 0 Hz is not allowed."]),
        ({"scores": [[1.0]] * 3}, ["scores must be numbers of the shape of keypoints_px"]),
        ({"scores": {}}, ["scores must be numbers of the shape of keypoints_px"]),
        ({"frame_rate_hz": None, "times_s": {"left": [0.0]}}, ["times_s has arrays of unknown cameras: left."]),
        (
            {"frame_rate_hz": None, "times_s": np.arange(20) * np.timedelta64(40, "ms")},
            ["times_s must be 20 ascending"],
        ),
        ({"keypoints_px": np.full((3, 20, 17, 2), 1j)}, ["keypoints_px must be numbers of the shape"]),
        ({"keypoints_px": np.full((3, 20, 17, 2), 1e9), "scores": None}, ["A coordinate of a joint is not within"]),
    ],
)
def test_wrong_argument_gets_sentence(opened: KeypointSession, changes: dict[str, Any], sentences: list[str]) -> None:
    keypoints_px, scores = arrays_of(opened)
    arguments: dict[str, Any] = {
        "keypoints_px": keypoints_px,
        "scores": scores,
        "cameras": opened.cameras,
        "frame_rate_hz": 25.0,
    }
    with pytest.raises(InputError) as caught:
        Session.from_arrays(**(arguments | changes))
    messages = [problem.message for problem in caught.value.problems]
    assert all(any(message.startswith(sentence) for message in messages) for sentence in sentences), messages


def test_camera_of_wrong_numbers_is_refused() -> None:
    camera = Camera("left", (0, 5), np.zeros((3, 3)), np.zeros(5), Rigid3(np.zeros((3, 3)), np.zeros(3)))
    with pytest.raises(InputError) as caught:
        Session.from_arrays([np.zeros((2, 17, 2))], None, [camera], 25.0)
    assert {problem.field for problem in caught.value.problems} == {"size", "matrix", "rotation"}


def test_pose_of_wrong_type_is_refused(opened: KeypointSession) -> None:
    camera = replace(opened.cameras[0], cam_from_world=np.eye(4))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="cam_from_world must be a Rigid3"):
        Session.from_arrays([np.zeros((2, 17, 2))], None, [camera], 25.0)


def test_named_dimensions_and_names_in_arrays_are_read(opened: KeypointSession) -> None:
    """Arrays as ``movement`` has them, of all cameras, and joints and times of pandas give the session of lists."""
    keypoints_px, _ = arrays_of(opened)
    plain, names = [points_px[:, :1] for points_px in keypoints_px.values()], opened.joints.names
    stacked = xr.DataArray(np.stack(plain), dims=("view", "time", "individuals", "keypoints", "space"))
    ordered = stacked.transpose("time", "view", "space", "keypoints", "individuals")
    times_s = np.arange(len(plain[0])) / 25
    expected = Session.from_arrays(plain, None, opened.cameras, times_s=times_s, joints=names)
    for arrays in (ordered, ordered.assign_coords(view=list(keypoints_px))):
        session = Session.from_arrays(arrays, None, opened.cameras, None, pd.Series(times_s), pd.Index(names))
        for name, detections in expected.detections.items():
            np.testing.assert_array_equal(session.detections[name].keypoints_px, detections.keypoints_px)


def test_masked_points_are_not_detected(opened: KeypointSession) -> None:
    keypoints_px, _ = arrays_of(opened)
    masked = {name: np.ma.masked_array(points_px, False) for name, points_px in keypoints_px.items()}
    name = next(iter(masked))
    masked[name][:, :, 0] = np.ma.masked
    session = Session.from_arrays(masked, None, opened.cameras, 25.0)
    assert np.isnan(session.detections[name].keypoints_px[:, 0]).all()


def test_shares_of_picture_and_percent_are_converted_with_findings(opened: KeypointSession) -> None:
    keypoints_px, scores = arrays_of(opened)
    shares = {camera.name: keypoints_px[camera.name] / np.subtract(camera.size_px, 1) for camera in opened.cameras}
    percent = {name: 100 * score for name, score in scores.items()}
    session = Session.from_arrays(shares, percent, opened.cameras, 25.0)
    assert {finding.code for finding in session.findings} == {"keypoints_scale"}
    for name, detections in opened.detections.items():
        np.testing.assert_allclose(session.detections[name].keypoints_px, detections.keypoints_px, atol=1e-6)
        np.testing.assert_allclose(session.detections[name].score, detections.score, atol=1e-9)


def test_camera_without_array_is_finding(opened: KeypointSession) -> None:
    keypoints_px, _ = arrays_of(opened)
    left_out = keypoints_px.popitem()[0]
    session = Session.from_arrays(keypoints_px, None, opened.cameras, 25.0)
    assert [finding.code for finding in session.findings] == ["camera_left_out"]
    assert left_out in session.findings[0].message


def test_text_of_session_is_short(opened: KeypointSession) -> None:
    assert len(repr(opened)) < 400


def test_crowd_in_frame_is_refused(opened: KeypointSession, tmp_path: Path) -> None:
    points_px = np.ones((3, 1, 200, 17, 2)) * np.arange(34).reshape(17, 2)
    with pytest.raises(InputError, match="keypoints_px has a frame with 200 people, more than allowed"):
        Session.from_arrays(points_px, None, opened.cameras, 25.0)
