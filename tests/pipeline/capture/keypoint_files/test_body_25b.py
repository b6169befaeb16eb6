"""Points in the order of BODY_25B are told apart from those of BODY_25."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.write import encode
from pipeline.capture.keypoint_files.body_25b import is_body_25b
from pipeline.capture.keypoint_files.writing import encode_frame
from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.data.detections import Detections
from pipeline.joints import BODY_25, BODY_FEET
from pipeline.layouts import LAYOUTS
from pipeline.simulation.scenes import SCENES, Simulation, record

RATE_HZ = 25.0
LAYOUT = LAYOUTS["body-25b"]


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(SCENES["room"], duration_s=0.6), 0, 3, "feet")


def content_25b(simulation: Simulation, detections: Detections, rows: np.ndarray) -> bytes:
    """People of a frame in OpenPose's form, in the order of BODY_25B."""
    people = []
    for row in np.flatnonzero(rows):
        points = np.zeros((len(LAYOUT.points), 3))
        for place, name in enumerate(LAYOUT.points):
            if name is not None:
                joint = simulation.joints.index(name)
                points[place] = [*np.nan_to_num(detections.keypoints_px[row, joint]), detections.score[row, joint]]
        shoulders = points[5:7]
        if (shoulders[:, 2] > 0).all():
            points[17] = shoulders.mean(0)
        people.append({"pose_keypoints_2d": points.ravel().tolist()})
    return json.dumps({"people": people}).encode()


def content_25(simulation: Simulation, detections: Detections, rows: np.ndarray) -> bytes:
    return encode_frame(detections.keypoints_px[rows], detections.score[rows], simulation.joints)


def opened(
    simulation: Simulation, folder: Path, content: Callable[[Simulation, Detections, np.ndarray], bytes]
) -> KeypointSession:
    for camera, detections in simulation.detections.items():
        (folder / camera).mkdir()
        for frame in range(simulation.timebase.num_frames):
            path = folder / camera / f"frame_{frame:012d}_keypoints.json"
            path.write_bytes(content(simulation, detections, detections.frame == frame))
    rig = folder.parent / "rig.json"
    rig.write_bytes(encode(simulation.cameras))
    return open_keypoints(folder, rig, frame_rate_hz=RATE_HZ)


def test_people_of_body_25b_are_rearranged(room: Simulation, tmp_path: Path) -> None:
    (tmp_path / "keypoints").mkdir()
    session = opened(room, tmp_path / "keypoints", content_25b)
    assert session.joints == BODY_FEET
    assert [finding.evidence for finding in session.findings if "BODY_25B" in finding.message] == [
        {"layout": "body-25b"}
    ]
    for camera, sent in room.detections.items():
        found = session.detections[camera]
        places = session.joints.indices(room.joints.names)
        np.testing.assert_allclose(found.keypoints_px[:, places], sent.keypoints_px, atol=1e-9)


def test_people_of_body_25_stay(room: Simulation, tmp_path: Path) -> None:
    (tmp_path / "keypoints").mkdir()
    session = opened(room, tmp_path / "keypoints", content_25)
    assert session.joints == BODY_25
    assert not any("BODY_25B" in finding.message for finding in session.findings)


def test_few_people_tell_nothing() -> None:
    people = np.random.default_rng(0).uniform(0.1, 100.0, (3, 25, 3))
    assert not is_body_25b([people])
    assert not is_body_25b([np.empty((0, 0, 3)), np.empty((0, 25, 3))])
