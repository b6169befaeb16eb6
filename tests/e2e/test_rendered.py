"""Accuracy on a rendered capture with exact truth; skipped without its folder."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.capture.session import open_session
from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.local import reconstruct
from pipeline.validation.evaluation.datasets.rendered import load_rendered, score_rendered
from tests.e2e.datasets import evaluated, folder_of, needs

# Frames of the slow test; the capture has 100.
NUM_FRAMES = 25


def require_good(scores: Mapping[str, Any]) -> None:
    assert scores["mpjpe_mm"] <= 47
    assert scores["pck150"] >= 0.95
    assert scores["recall"] >= 0.97
    assert scores["switches"] == 0
    assert scores["ghost_rate"] <= 0.03


@needs("rendered")
def test_rendered_people_of_second(task_cache: Path) -> None:
    folder = folder_of("rendered")
    truth = load_rendered(folder)
    first = replace(truth, time_s=truth.time_s[:NUM_FRAMES], xyz_m=truth.xyz_m[:, :NUM_FRAMES], feet_m=None)
    session = open_session(folder / "videos", folder / "calibration.toml")
    config = ReconstructionConfig(frame_range=(0, NUM_FRAMES), force=True)
    found = reconstruct(session, config, cache=task_cache)
    require_good(score_rendered(found.tracks, found.joints, found.timebase, first))


@needs("rendered")
@pytest.mark.accuracy
def test_rendered_people() -> None:
    require_good(evaluated("rendered"))
