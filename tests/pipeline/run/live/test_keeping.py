"""Packets of a live capture as a session, in layouts that OpenPose's form has, and in others."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.write import encode
from pipeline.capture.keypoints import open_keypoints
from pipeline.core.layouts import LAYOUTS
from pipeline.run.live.keeping import write_session
from pipeline.run.live.packets import framed
from pipeline.run.live.packing import pack_keypoints
from pipeline.validation.simulation.scenes import SCENES, record
from tests.pipeline.run.live.streams import sent_frames


@pytest.mark.parametrize("name", ["coco-17", "body-25b", "mediapipe-33"])
def test_points_of_layout_are_same_joints_in_session(tmp_path: Path, name: str) -> None:
    room = record(replace(SCENES["room"], duration_s=0.4), 0, 3)
    layout = LAYOUTS[name]
    shared = [joint for joint in room.joints.names if joint in layout.points]
    assert len(shared) == len(room.joints.names)
    with (tmp_path / "packets").open("w+b") as packets:
        for frame in sent_frames(room):
            points_px = np.full((len(frame.score), len(layout.points), 2), 5.0)
            score = np.full(points_px.shape[:2], 0.5)  # of points that are not used as well
            places = [layout.points.index(joint) for joint in shared]
            points_px[:, places], score[:, places] = frame.points_px, frame.score
            packets.write(framed(pack_keypoints(frame.camera, frame.time_s, points_px, score)))
        packets.seek(0)
        cameras = [camera.name for camera in room.cameras]
        archives = write_session(packets, tmp_path, cameras, name)
    (tmp_path / "calibration.json").write_bytes(encode(room.cameras))
    folders = {camera: tmp_path / camera for camera in archives}
    for camera, archive in archives.items():
        zipfile.ZipFile(tmp_path / archive).extractall(folders[camera])
    session = open_keypoints(folders, tmp_path / "calibration.json", tmp_path / "timestamps.csv")
    for camera in cameras:
        sent, kept = room.detections[camera], session.detections[camera]
        np.testing.assert_array_equal(kept.frame, sent.frame)
        found_px = kept.keypoints_px[:, session.joints.indices(room.joints.names)]
        np.testing.assert_allclose(found_px, sent.keypoints_px, atol=1e-3)


def test_frame_without_people_is_kept_empty(tmp_path: Path) -> None:
    with (tmp_path / "packets").open("w+b") as packets:
        for time_s, num_people in ((0.0, 1), (0.1, 0), (0.2, 1)):
            points_px = np.full((num_people, 17, 2), 5.0)
            packets.write(framed(pack_keypoints(0, time_s, points_px, np.full((num_people, 17), 0.5))))
        packets.seek(0)
        archives = write_session(packets, tmp_path, ["cam01"], "coco-17")
    with zipfile.ZipFile(tmp_path / archives["cam01"]) as archive:
        frames = [json.loads(archive.read(name))["people"] for name in archive.namelist()]
    assert [len(people) for people in frames] == [1, 0, 1]
