import hashlib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from pipeline.capture.preflight_npz import decode_keypoints, decode_session, record_sha256
from pipeline.capture.session import CaptureSession
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.rigid import Rigid3
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import CALIBRATION_NOTE
from pipeline.video.info import VideoInfo
from tests.pipeline.own_point_scenes import own_scene
from tests.records import encode_record

RNG = np.random.default_rng(3)


def video(name: str, num_frames: int) -> VideoInfo:
    pts = np.arange(num_frames) * 512
    return VideoInfo(Path("/a/b") / name, "h264", (640, 480), 90, pts, pts[::10], pts / 15360.0, 30.0)


def camera(name: str) -> Camera:
    return Camera(name, (640, 480), RNG.normal(size=(3, 3)), RNG.normal(size=5), Rigid3(np.eye(3), RNG.normal(size=3)))


def test_session_comes_back_with_its_videos_where_they_are_now(tmp_path: Path) -> None:
    session = CaptureSession(
        cameras=(camera("left"), camera("Käm 2")),
        videos=(video("left.mp4", 30), replace(video("Käm 2.mp4", 20), is_mirrored=True)),
        times={"left": FrameTimes(np.arange(30) / 30.0), "Käm 2": FrameTimes(np.arange(20) / 30.0 + 0.1)},
        findings=(Finding(CALIBRATION_NOTE, "They are near."),),
    )
    content = encode_record(session)
    assert encode_record(session) == content
    assert record_sha256(session) == hashlib.sha256(content).hexdigest()
    back = decode_session(content, tmp_path)
    assert back.findings == session.findings
    for ours, theirs in zip(session.cameras, back.cameras, strict=True):
        assert (theirs.name, theirs.size_px) == (ours.name, ours.size_px)
        np.testing.assert_array_equal(theirs.matrix, ours.matrix)
        np.testing.assert_array_equal(theirs.distortion, ours.distortion)
        np.testing.assert_array_equal(theirs.cam_from_world.rotation, ours.cam_from_world.rotation)
        np.testing.assert_array_equal(theirs.cam_from_world.translation_m, ours.cam_from_world.translation_m)
        np.testing.assert_array_equal(back.times[ours.name].time_s, session.times[ours.name].time_s)
    for our_video, their_video in zip(session.videos, back.videos, strict=True):
        assert their_video.path == tmp_path / our_video.path.name
        for field in fields(VideoInfo):
            if field.name != "path":
                np.testing.assert_array_equal(getattr(their_video, field.name), getattr(our_video, field.name))


def test_own_points_come_back_from_record() -> None:
    session = own_scene(duration_s=0.2).session
    found = decode_keypoints(encode_record(session))
    assert found.own.names == ("racket_tip", "ball")
    for kind in ("of_bodies", "of_scene"):
        for name, rows in getattr(session.own, kind).items():
            np.testing.assert_array_equal(getattr(found.own, kind)[name].keypoints_px, rows.keypoints_px)
            np.testing.assert_array_equal(getattr(found.own, kind)[name].frame, rows.frame)
