"""Long takes of keypoints: how they are made, and what a frame costs in them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from pipeline.validation.simulation.scenes import SCENES, record
from tests.benchmarks.__main__ import app
from tests.benchmarks.length import growth, long_session

# Loose: two runs on a busy machine differ by a quarter.
MAX_RATIO = 1.6


def test_long_session_repeats_clip_to_and_fro() -> None:
    clip = record(replace(SCENES["room"], duration_s=0.4), 0, 2)
    num_clip = clip.timebase.num_frames
    session = long_session(clip, 3 * num_clip - 2)
    assert session.timebase.num_frames == 3 * num_clip - 2
    for camera, seen in clip.detections.items():
        longer = session.detections[camera]
        assert (np.diff(longer.frame) >= 0).all()
        assert longer.frame[-1] < 3 * num_clip - 2
        last = seen.keypoints_px[seen.frame == num_clip - 1]
        for frame in (num_clip - 1, num_clip):
            np.testing.assert_array_equal(longer.keypoints_px[longer.frame == frame], last)
        assert len(session.times[camera].time_s) == 3 * num_clip - 2


def test_growth_is_ratio_of_costs_per_frame() -> None:
    short = {"frames": 100, "cpu_s": {"associate": 1.0, "fit": 2.0, "start": 0.0}}
    long = {"frames": 400, "cpu_s": {"associate": 4.0, "fit": 16.0}}
    assert growth([short, long]) == {"associate": 1.0, "fit": 2.0}


@pytest.mark.benchmark
def test_no_stage_grows_faster_than_take() -> None:
    """A stage that looks at the whole take for each step of a person is slow in takes of many minutes alone."""
    command = ["length", "--minutes", "3", "45", "--people", "1", "--json"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    costly = {stage for stage, seconds in document["takes"][0]["cpu_s"].items() if seconds > 1.0}
    ratios = {stage: document["ratio_of_cost_per_frame"][stage] for stage in costly}
    assert max(ratios.values()) < MAX_RATIO, ratios
