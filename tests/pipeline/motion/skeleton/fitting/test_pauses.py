"""Fit of pictures with pauses between them: nothing is smoothed over a pause."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Bool

from pipeline.core.data.cameras import Timebase
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.fitting.positions import stretches
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.motion.skeleton.observed import observe, ring_of

RATE_HZ = 25.0


def mask(*seen: int, num_frames: int = 20) -> Bool[np.ndarray, " frames"]:
    return np.isin(np.arange(num_frames), seen)


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        ((0, 1, 5, 9), [(0, 20)]),
        ((0, 1, 6, 9), [(0, 2), (6, 20)]),
        ((3, 10, 18), [(0, 4), (10, 11), (18, 20)]),
        ((), [(0, 20)]),
    ],
)
def test_stretches_end_at_pauses(seen: tuple[int, ...], expected: list[tuple[int, int]]) -> None:
    assert stretches(mask(*seen), 3) == [slice(*rows) for rows in expected]


@pytest.mark.slow
@pytest.mark.parametrize("burst", [1, 3])
def test_people_in_pictures_seconds_apart_stay_where_seen(burst: int) -> None:
    """Pictures by three cameras every two seconds, a third of the joints missing, of a person who walks about."""
    scene = replace(find_scene("room"), duration_s=30.0)
    truth_m = np.array(record(scene, 2, 1).truth_m[1])
    is_picture = np.arange(len(truth_m)) % 50 < burst
    rng = np.random.default_rng(5)
    cameras = ring_of(4)
    unseen = rng.random((len(truth_m), len(cameras), len(COCO_17.names))) < 0.3
    unseen[~is_picture] = True
    track, seen = observe(cameras, truth_m, noise_px=2.5, unseen=unseen, seed=6)
    timebase = Timebase(0.0, RATE_HZ, len(truth_m))
    (fitted,) = animate([track], [seen], cameras, timebase, COCO_17, ReconstructionConfig()).tracks
    known = np.isfinite(track.xyz_m).all(-1)
    assert known[is_picture].mean() > 0.7
    raw_m, fit_m = (np.linalg.norm(xyz_m - truth_m, axis=-1)[known] for xyz_m in (track.xyz_m, fitted.xyz_m))
    assert np.median(fit_m) < np.median(raw_m)
    moved_m = np.linalg.norm(fitted.xyz_m - track.xyz_m, axis=-1)[known]
    assert (moved_m > 0.1).mean() < 0.03
