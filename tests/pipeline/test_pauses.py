"""Pauses of a session take no time, memory or progress steps, whatever their length."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.options.config import Method, ReconstructionConfig
from pipeline.core.progress import Progress
from pipeline.run.engine.local import reconstruct
from pipeline.run.engine.stage import FIT, HOLD
from pipeline.validation.simulation.scenes import find_scene, record


def two_takes(pause_s: float) -> KeypointSession:
    """Detections of three people over one second, twice with a pause."""
    once = record(replace(find_scene("unsynchronised"), duration_s=1.0), seed=4)
    times = {name: np.concatenate([one.time_s, one.time_s + pause_s]) for name, one in once.times.items()}
    rate_hz = once.timebase.frame_rate_hz
    end_s = max(float(time_s[-1]) for time_s in times.values())
    return KeypointSession(
        cameras=once.cameras,
        times={name: FrameTimes(time_s) for name, time_s in times.items()},
        timebase=Timebase(0.0, rate_hz, round(end_s * rate_hz) + 1),
        detections={
            name: Detections(
                name,
                np.concatenate([one.frame, one.frame + len(once.times[name].time_s)]),
                *(np.concatenate([values, values]) for values in (one.keypoints_px, one.score, one.box_px)),
            )
            for name, one in once.detections.items()
        },
        joints=once.joints,
        folders={},
        findings=(),
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_pause_of_nine_hours(method: Method) -> None:
    steps: Counter[str] = Counter()

    def on_progress(progress: Progress) -> None:
        steps[progress.stage] += 1
        assert progress.done <= progress.total

    config = ReconstructionConfig(method=method, smoothing="none")
    session = two_takes(32_400.0)
    found = reconstruct(session, config, on_progress)
    assert session.timebase.num_frames > 970_000
    assert steps[HOLD] == steps[FIT]
    assert steps.total() - steps[HOLD] < 320
    short = reconstruct(two_takes(30.0), config)
    starts = [track.start_frame for track in found.tracks]
    assert len(starts) == 6
    assert starts == [
        track.start_frame if track.start_frame < 100 else track.start_frame + 971_100 for track in short.tracks
    ]
    for one, other in zip(found.tracks, short.tracks, strict=True):
        np.testing.assert_allclose(one.xyz_m, other.xyz_m, atol=1e-6)


@pytest.mark.parametrize("method", ["tracking", pytest.param("clustering", marks=pytest.mark.slow)])
@pytest.mark.parametrize("frames", [(2000, 3000), pytest.param((10, 972_020), marks=pytest.mark.slow)])
def test_frames_that_are_wanted_around_pause_and_in_it(method: Method, frames: tuple[int, int]) -> None:
    config = ReconstructionConfig(method=method, smoothing="none", frame_range=frames)
    found = reconstruct(two_takes(32_400.0), config)
    assert bool(found.tracks) == (frames[0] == 10)
