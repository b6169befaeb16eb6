"""Times at which frames were taken, from their own times and those of their arrival."""

import numpy as np
import pytest

from pipeline.run.live.clocks import LateFrames, PlaybackClock, StreamClock


def test_jitter_of_arrival_moves_no_frame() -> None:
    """The camera's clock is 7 s ahead and drifts by 100 ppm; each hundredth frame or so arrives without jitter."""
    random, clock = np.random.default_rng(0), StreamClock()
    taken_s = np.arange(0, 600, 0.04)
    stamp_s = 7.0 + taken_s * (1 - 1e-4)
    arrived_s = 100.0 + taken_s + 0.05 + random.exponential(0.02, len(taken_s))
    late_s = [clock.arrive(stamp, now) for stamp, now in zip(stamp_s, arrived_s, strict=True)]
    found_s = []
    clock = StreamClock()
    for stamp, now in zip(stamp_s.tolist(), arrived_s.tolist(), strict=True):
        clock.arrive(stamp, now)
        found_s.append(clock.capture_s(stamp))
    error_s = np.array(found_s) - (100.0 + taken_s + 0.05)
    assert np.abs(error_s[100:]).max() < 0.004
    assert min(late_s) == 0.0
    assert np.std(arrived_s - taken_s) > 0.015


def test_stream_that_counts_anew_is_followed() -> None:
    clock = StreamClock()
    assert clock.arrive(5.0, 50.0) == 0.0
    assert clock.arrive(9000.0, 50.04) == 0.0
    assert clock.capture_s(9000.0) == pytest.approx(50.04)


def test_frame_that_was_decoded_too_late_is_known() -> None:
    clock = StreamClock()
    clock.arrive(0.0, 10.0)
    assert 1.9 < clock.arrive(1.0, 13.0) <= 2.0
    playback = PlaybackClock(100.0, 0.5)
    assert playback.capture_s(1.5) == 101.0
    assert playback.arrive(1.5, 103.0) == 2.0


def left_out(arrivals: list[tuple[float, float]]) -> list[bool]:
    """Frames that are left out, as booleans, of stamps and times of arrival; each tenth one is a keyframe."""
    clock, late = StreamClock(), LateFrames()
    return [late.leaves_out(clock, stamp, now, number % 10 == 0) for number, (stamp, now) in enumerate(arrivals)]


def test_decoder_that_is_behind_goes_on_at_keyframe() -> None:
    """From frame 25 on the machine is 2 s behind; without decoding it reads what has waited at once."""
    arrivals = [(0.1 * k, 0.1 * k if k < 25 else max(0.1 * k, 4.5 + 0.001 * k)) for k in range(80)]
    assert [number for number, is_out in enumerate(left_out(arrivals)) if is_out] == list(range(25, 40))


def test_times_that_jump_back_lose_frames_to_keyframe() -> None:
    arrivals = [(0.1 * k if k < 25 else 0.1 * k - 3.0, 0.1 * k) for k in range(80)]
    assert [number for number, is_out in enumerate(left_out(arrivals)) if is_out] == list(range(25, 30))
