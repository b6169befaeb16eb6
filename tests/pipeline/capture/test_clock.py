"""Limits of a session's clock, and the cameras and fields that violate them."""

from collections.abc import Mapping

import numpy as np
import pytest

from pipeline.capture.clock import TimeSource, clock_problems
from pipeline.core.data.cameras import FrameTimes
from pipeline.core.errors import Problem

DAY_S = 86_400.0


Spans = Mapping[str, tuple[float, float, float]]


def found(spans: Spans, rate_hz: float | None = None) -> Mapping[str, list[Problem]]:
    """Problems by code for cameras with a start, a duration and a rate each."""
    times = {
        name: FrameTimes(start_s + np.arange(round(duration_s * hz) + 1) / hz)
        for name, (start_s, duration_s, hz) in spans.items()
    }
    source = TimeSource({name: f"{name}.mp4" for name in spans}, "offset_s", "rate", "Check it.", "Cut it.")
    start_s = min(start_s for start_s, _, _ in spans.values())
    problems = clock_problems(times, start_s, rate_hz or max(hz for _, _, hz in spans.values()), source)
    by_code: dict[str, list[Problem]] = {}
    for problem in problems:
        by_code.setdefault(problem.code, []).append(problem)
    return by_code


def places(problems: list[Problem]) -> list[tuple[str | None, str | None, str | None]]:
    assert all(problem.hint for problem in problems)
    return [(problem.file, problem.camera, problem.field) for problem in problems]


@pytest.mark.parametrize(
    "spans",
    [
        {"a": (0.0, 1.0, 5.0), "b": (0.5, 1.0, 240.0)},
        {"a": (-DAY_S, 10.0, 25.0), "b": (5.0 - DAY_S, 10.0, 25.0)},  # a clock that shows the time of day
        {"a": (0.0, 43_200.0, 20.0), "b": (0.0, 1.0, 20.0)},
        {"a": (0.0, 7200.0, 120.0), "b": (0.0, 1.0, 120.0)},
        {"a": (0.0, 999.999, 1000.0), "b": (0.0, 1.0, 1000.0)},  # the last frame that is taken
    ],
)
def test_clocks_within_limits(spans: Spans) -> None:
    assert not found(spans)


def test_two_pairs_of_cameras_that_are_two_days_apart() -> None:
    """Each camera overlaps with another camera, and all of them give 172 million frames."""
    spans = {"a": (-DAY_S, 5.0, 1000.0), "b": (-DAY_S, 5.0, 25.0), "c": (DAY_S, 5.0, 25.0), "d": (DAY_S, 6.0, 25.0)}
    problems = found(spans)
    assert problems.keys() == {"session_too_long"}
    assert places(problems["session_too_long"]) == [("d.mp4", "d", "offset_s")]
    assert "172,806.00 s" in str(problems["session_too_long"][0])


def test_fastest_camera_of_session_with_too_many_frames_is_named() -> None:
    problems = found({"a": (0.0, 3600.0, 25.0), "fast": (10.0, 1.0, 1000.0)})
    assert problems.keys() == {"too_many_frames"}
    assert places(problems["too_many_frames"]) == [("fast.mp4", "fast", "rate")]
    assert "3,600,001" in str(problems["too_many_frames"][0])


def test_all_cameras_that_are_wrong_are_named_at_once() -> None:
    problems = found(
        {"a": (0.0, 10.0, 25.0), "b": (0.0, 50_000.0, 1.0), "c": (60_000.0, 1.0, 25.0), "d": (0.0, 43_201.0, 1.0)}
    )
    assert places(problems["no_overlap"]) == [("c.mp4", "c", "offset_s")]
    assert places(problems["session_too_long"]) == [("b.mp4", "b", "rate"), ("d.mp4", "d", "rate")]


def test_rate_that_is_none_is_not_multiplied() -> None:
    assert not found({"a": (0.0, 1.0, 25.0), "b": (0.0, 1.0, 25.0)}, rate_hz=float("inf"))
