"""Share of true heads inside the regions of a take's people."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17
from pipeline.validation.evaluation.covered_heads import score_covered_heads
from pipeline.validation.evaluation.datasets.rendered import RenderedTruth
from tests.pipeline.export.test_overlay import CAMERA
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

NUM_FRAMES, RATE_HZ = 20, 25.0
TIME_S = np.arange(NUM_FRAMES) / RATE_HZ
WALK_M = walker(NUM_FRAMES, RATE_HZ) - np.array([1.0, 2.0, 0.0])
TRUTH = RenderedTruth(COCO_17.names, TIME_S, np.stack([WALK_M, WALK_M + np.array([0.8, 0.0, 0.0])]))


def take(*xyz_m: np.ndarray) -> Reconstruction:
    tracks = tuple(track_of(person_m, number) for number, person_m in enumerate(xyz_m, 1))
    timebase = Timebase(0.0, RATE_HZ, NUM_FRAMES)
    return Reconstruction((CAMERA,), COCO_17, timebase, tracks, (), Animation(tracks, (), None))


@pytest.mark.parametrize(("num_found", "share"), [(0, 0.0), (1, 0.5), (2, 1.0)])
def test_each_head_counts(num_found: int, share: float) -> None:
    found = take(*TRUTH.xyz_m[:num_found])
    assert score_covered_heads(found, {"front": FrameTimes(TIME_S)}, TRUTH)["heads_covered"] == pytest.approx(share)


def test_only_heads_in_the_picture_at_known_times_count() -> None:
    found = take(WALK_M)
    far = replace(TRUTH, xyz_m=np.stack([WALK_M, WALK_M + np.array([9.0, 0.0, 0.0])]))
    assert score_covered_heads(found, {"front": FrameTimes(TIME_S)}, far)["heads_covered"] == 1.0
    late = FrameTimes(TIME_S + 100.0)
    assert score_covered_heads(found, {"front": late}, TRUTH)["heads_covered"] is None
