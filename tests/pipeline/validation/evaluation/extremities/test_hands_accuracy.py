"""Accuracy of hands: errors relative to the wrist, measured hands, and fingers that bend backwards."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.animation import Side
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import COCO_17, WHOLE_BODY, finger_joints
from pipeline.validation.evaluation.extremities.hands import bends_deg, count_backward_bends, score_hands
from pipeline.validation.simulation.motion.hands import ANGLES, DIP_SHARE, Hands, fingers
from pipeline.validation.simulation.scenes import SCENES, record

SIMULATION = record(replace(SCENES["hands"], duration_s=5.0), 1, 2, "whole")
LEFT = WHOLE_BODY.indices(finger_joints("left"))


def tracks(move_m: np.ndarray | None = None) -> list[Track3D]:
    shape = SIMULATION.truth_m.shape[1:3]
    return [
        Track3D(
            number + 1,
            0,
            xyz_m + (0.0 if move_m is None else move_m),
            np.ones(shape),
            np.full(shape, Source.MEASURED),
            np.zeros(shape),
            np.full(shape, 2),
        )
        for number, xyz_m in enumerate(SIMULATION.truth_m)
    ]


def bent(**angles_deg: float) -> np.ndarray:
    """Wrists and fingers (2, 1, 21, 3) of a left and of a right hand with given angles, in metres."""
    angles = np.zeros((1, 2, len(ANGLES)))
    for name, angle in angles_deg.items():
        angles[..., ANGLES.index(name)] = np.radians(angle)
    wrists_m = np.array([[[0.25, 0.2, 0.0], [0.25, -0.2, 0.0]]])
    elbows_m = wrists_m - np.array([0.25, 0.0, 0.0])
    points_m = fingers(Hands(1.0, angles), elbows_m + np.array([0.0, 0.0, 0.3]), elbows_m, wrists_m)
    return np.concatenate([wrists_m[:, :, None], points_m.reshape(1, 2, 20, 3)], axis=2).swapaxes(0, 1)


def test_the_truth_has_no_error_and_bends_nowhere_backwards() -> None:
    scores = score_hands(tracks(), SIMULATION, WHOLE_BODY)
    assert scores["finger_mm"] == pytest.approx(0.0, abs=1e-6)
    assert scores["hands_measured"] == 1.0
    assert scores["backward_bends"] == 0
    assert set(scores["finger_by_joint_mm"]) == {"cmc", "mcp", "ip", "pip", "dip", "tip"}


def test_errors_are_relative_to_the_wrist() -> None:
    move_m = np.full((61, 3), [0.03, 0.0, 0.0])
    assert score_hands(tracks(move_m), SIMULATION, WHOLE_BODY)["finger_mm"] == pytest.approx(0.0, abs=1e-6)
    move_m[LEFT] += [0.0, 0.01, 0.0]
    scores = score_hands(tracks(move_m), SIMULATION, WHOLE_BODY)
    assert scores["finger_mm"] == pytest.approx(5.0)
    assert scores["finger_p95_mm"] == pytest.approx(10.0)


def test_predicted_hands_are_not_measured() -> None:
    source = np.full(SIMULATION.truth_m.shape[1:3], Source.MEASURED)
    source[:50, LEFT] = Source.PREDICTED
    move_m = np.zeros((61, 3))
    found = [replace(track, source=source) for track in tracks(move_m)]
    far_m = np.where((source == Source.PREDICTED)[..., None], 0.1, 0.0) * np.array([0.0, 1.0, 0.0])
    found = [replace(track, xyz_m=track.xyz_m + far_m) for track in found]
    scores = score_hands(found, SIMULATION, WHOLE_BODY)
    num_frames = SIMULATION.timebase.num_frames
    assert scores["hands_measured"] == pytest.approx(1 - 50 / (2 * num_frames))
    assert scores["finger_mm"] == pytest.approx(0.0, abs=1e-6)
    assert scores["finger_all_mm"] == pytest.approx(100.0 * 50 / (2 * num_frames))


def test_tracks_without_hands_have_no_figures() -> None:
    parts = ("xyz_m", "score", "source", "error_px", "views")
    bodies = [replace(track, **{part: getattr(track, part)[:, :17] for part in parts}) for track in tracks()]
    scores = score_hands(bodies, SIMULATION, COCO_17)
    assert scores["finger_mm"] is None
    assert scores["backward_bends"] is None
    assert scores["hands_measured"] == 0.0


def test_bends_are_the_angles_of_the_hinges() -> None:
    both_m = bent(thumb_radial=35.0, thumb_palmar=20.0, thumb_mcp=20.0, thumb_ip=30.0, ring_mcp=25.0, ring_pip=40.0)
    sides: tuple[Side, Side] = ("left", "right")
    for hand_m, side in zip(both_m, sides, strict=True):
        bends = bends_deg(hand_m, side)[0]
        np.testing.assert_allclose(bends[:2], [20.0, 30.0], atol=1e-6)
        # The palm's middle finger lies a little behind the others: the axes of the palm are tilted by two degrees.
        np.testing.assert_allclose(bends[2:6], [0.0, 0.0, 25.0, 0.0], atol=5.0)
        np.testing.assert_allclose(bends[10:12], [40.0, DIP_SHARE * 40.0], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "angle", "expected"),
    [("index_pip", -20.0, 2), ("index_pip", 20.0, 0), ("pinky_mcp", -60.0, 1), ("pinky_mcp", -10.0, 0),
     ("thumb_ip", -30.0, 1)],
)  # fmt: skip
@pytest.mark.parametrize("side", ["left", "right"])
def test_backward_bends_are_counted(name: str, angle: float, expected: int, side: str) -> None:
    natural = {"thumb_radial": 35.0, "thumb_palmar": 20.0, "index_pip": 8.0, "middle_pip": 8.0, "ring_pip": 8.0}
    wanted = natural | {"pinky_pip": 8.0, name: angle}
    hand_m = bent(**wanted)[("left", "right").index(side)]
    xyz_m = np.full((1, 61, 3), np.nan)
    xyz_m[:, WHOLE_BODY.indices((f"{side}_wrist", *finger_joints(side)))] = hand_m
    shape = xyz_m.shape[:2]
    track = Track3D(1, 0, xyz_m, np.ones(shape), np.full(shape, Source.MEASURED), np.zeros(shape), np.full(shape, 2))
    assert count_backward_bends([track], WHOLE_BODY) == expected
