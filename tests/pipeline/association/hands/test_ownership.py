"""Detections of each person."""

import numpy as np

from pipeline.association.hands.attach import owners
from pipeline.association.tracking.observations import UNASSIGNED, Detections2D
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Observations, People, Track3D

NUM_JOINTS = 17
TIMEBASE = Timebase(1.0, 10.0, 20)


def body_px(x: float) -> np.ndarray:
    """Body of 100 by 300 pixels."""
    rng = np.random.default_rng(3)
    return rng.uniform([x, 0.0], [x + 100.0, 300.0], (NUM_JOINTS, 2))


def person(number: int, start_frame: int, points_px: np.ndarray) -> tuple[Track3D, Observations]:
    """Person whom two cameras see."""
    frames = len(points_px)
    plain = np.zeros((frames, NUM_JOINTS))
    track = Track3D(
        number, start_frame, np.zeros((frames, NUM_JOINTS, 3)), plain, plain.astype(int), plain, plain.astype(int)
    )
    score = np.where(np.isfinite(points_px).all(-1), 0.5, 0.0)
    return track, Observations(number, points_px, score)


def test_detections_belong_to_whoever_has_their_joints() -> None:
    left, right, other = body_px(0.0), body_px(60.0), body_px(600.0)
    unseen = np.full((NUM_JOINTS, 2), np.nan)
    people = [
        person(1, 2, np.array([[left, unseen], [left + 6.0, unseen], [left + 12.0, other]])),
        person(2, 0, np.array([[right, unseen]] * 4)),
    ]
    rows = [  # camera, frame, time, joints, owner
        (0, 0, 1.0, right + 3.0, 1),
        (0, 1, 1.2, right + 1.0, 1),
        (0, 1, 1.2, left - 1.0, 0),
        (0, 2, 1.26, left + 4.0, 0),  # between two output frames
        (0, 3, 1.9, left, UNASSIGNED),  # after the person has gone
        (1, 0, 1.3, other, UNASSIGNED),  # this camera saw no person then
        (1, 1, 1.4, other, 0),
        (1, 2, 1.4, body_px(300.0), UNASSIGNED),
    ]
    bodies = Detections2D(
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        np.array([row[2] for row in rows]),
        np.array([row[3] for row in rows]),
        np.full((len(rows), NUM_JOINTS), 0.5),
        np.zeros((len(rows), 0, 0), np.uint8),
    )
    tracks, observations = zip(*people, strict=True)
    everybody = People(tracks, observations)
    np.testing.assert_array_equal(owners(everybody, bodies, TIMEBASE), [row[4] for row in rows])
