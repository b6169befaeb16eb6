"""`multicap benchmark live` on small scenes."""

import time
from dataclasses import replace

import numpy as np
import pytest

from api.cli.benchmark import live_latency
from api.cli.benchmark.tracking import crowd
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import LiveInstant
from pipeline.validation.simulation.scenes import SCENES, record


def test_sizes_have_latencies_of_tracks_and_of_skeletons(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_latency, "_SIZES", ((3, 2, 25.0),))
    (size,) = live_latency.measure_sizes(4.0)
    assert list(size) == [
        "cameras", "people", "rate_hz", "dropped", "p50_ms", "p95_ms", "p99_ms", "tracks_p50_ms", "tracks_p95_ms",
        "tracks_p99_ms",
    ]  # fmt: skip
    assert (size["cameras"], size["people"], size["rate_hz"], size["dropped"]) == (3, 2, 25.0, 0)
    assert 0 < size["tracks_p50_ms"] <= size["tracks_p95_ms"] <= size["tracks_p99_ms"]
    assert size["tracks_p50_ms"] < size["p50_ms"]


@pytest.mark.parametrize("slowness", [1.0, 3.0])
def test_frames_wait_while_core_is_busy(monkeypatch: pytest.MonkeyPatch, slowness: float) -> None:
    """A core that needs 30 ms for each of three frames every 40 ms falls behind by 50 ms an instant."""
    ticks = iter(0.03 / slowness * np.repeat(np.arange(10_000), 2)[1:])
    monkeypatch.setattr(time, "thread_time", lambda: next(ticks))
    taken_ms, num_dropped = live_latency.latencies_ms(crowd(3, 2, 2.0), live_latency._NEVER_S, slowness)
    np.testing.assert_allclose(taken_ms, 90.0 + 50.0 * np.arange(len(taken_ms)), atol=1e-6)
    assert num_dropped == 0
    assert len(taken_ms) == 50


@pytest.mark.slow
def test_switches_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    room = record(replace(SCENES["room"], duration_s=5.0), 0)
    figures = live_latency.compare_with_finished(room)
    assert figures["switches"] == 0
    assert figures["fit_mm"] < 10.0
    assert 1.0 < figures["ratio"] == pytest.approx(figures["live_mm"] / figures["fit_mm"])
    push = LiveCapture.push

    def exchanged(capture: LiveCapture, *frame: object) -> list[LiveInstant]:
        """Live people whose numbers 1 and 2 are exchanged from the third second on."""
        return [
            replace(
                instant,
                people=tuple(
                    replace(p, id=3 - p.id if instant.time_s >= 3.0 and p.id < 3 else p.id) for p in instant.people
                ),
            )
            for instant in push(capture, *frame)  # type: ignore[arg-type]
        ]

    monkeypatch.setattr(LiveCapture, "push", exchanged)
    assert live_latency.compare_with_finished(room)["switches"] == 2


def test_memory_is_measured_after_minutes_of_one_capture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_latency, "_LOOP_S", 2.0)
    memory = live_latency.memory_mib((1, 3), num_people=2, rate_hz=25.0)
    assert list(memory["minutes"]) == ["1", "3"]
    assert all(mib > 50.0 for mib in memory["minutes"].values())
    # A take that turns around does not lose people.
    assert (memory["numbers"], memory["dropped"]) == (2, 0)
