"""Planted faults of simulated takes are put right by at most six actions: the person is as without the fault."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from pipeline.core.options.edits import Correction, ExchangeSides, IgnoreDetections, KeyJoint
from tests.cases import accuracy_but
from tests.pipeline.motion.skeleton.corrections.faults import FaultyTake, taken

CASES = [("room", 11), *((scene, seed) for scene in ("room", "contact") for seed in (1, 2, 3))]


def keyed(take: FaultyTake, joint: str, rows: Sequence[int]) -> list[Correction]:
    """Keys at true places."""
    places_m = take.truth_m[:, take.index(joint)]
    start = take.located.start_frame
    return [
        KeyJoint(person=1, joint=joint, frame=start + row, place_m=(float(x), float(y), float(z)))
        for row in rows
        for x, y, z in [places_m[row]]
    ]


def exchanged(clean: FaultyTake) -> tuple[FaultyTake, list[Correction]]:
    rows = slice(70, 82)
    frames = clean.located.frames[rows]
    exchange = ExchangeSides(person=1, part="all", start_frame=frames.start, stop_frame=frames.stop)
    return clean.sides_exchanged(rows), [exchange]


def wrong_elbow(clean: FaultyTake) -> tuple[FaultyTake, list[Correction]]:
    """Two cameras see the elbow 15 cm off, and no other camera sees it."""
    take = clean.seen_elsewhere("left_elbow", slice(60, 68), np.array([0.09, 0.09, 0.08]), [0, 1])
    names, frames = [camera.name for camera in take.simulation.cameras[:2]], take.located.frames[60:68]
    ignored: list[Correction] = [
        IgnoreDetections(person=1, camera=name, part="left_elbow", start_frame=frames.start, stop_frame=frames.stop)
        for name in names
    ]
    return take, [*ignored, *keyed(take, "left_elbow", (61, 64, 66))]


def lost_wrist(clean: FaultyTake) -> tuple[FaultyTake, list[Correction]]:
    rate_hz = clean.simulation.timebase.frame_rate_hz
    rows = slice(80, 80 + round(0.6 * rate_hz))
    take = clean.seen_elsewhere("right_wrist", rows, np.zeros(3), [])
    at = np.linspace(rows.start, rows.stop - 1, 8)[1:-1].round().astype(int).tolist()
    return take, keyed(take, "right_wrist", at)


@pytest.mark.parametrize("planted", [exchanged, wrong_elbow, lost_wrist])
@pytest.mark.parametrize(("scene", "seed"), accuracy_but([("room", 11)], CASES))
def test_planted_fault_is_put_right(
    planted: Callable[[FaultyTake], tuple[FaultyTake, list[Correction]]], scene: str, seed: int
) -> None:
    clean = taken(scene=scene, seed=seed)
    take, corrections = planted(clean)
    assert len(corrections) <= 6
    corrected, _ = take.corrected(corrections)
    clean_mm, corrected_mm = clean.error_mm(clean.person[0]), take.error_mm(corrected)
    assert corrected_mm < 1.1 * clean_mm
