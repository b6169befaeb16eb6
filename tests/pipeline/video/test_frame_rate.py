"""Frame rates: the laws of snapping, rates of rounded times, and rates of video files."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.video.frame_rate import (
    measured_rate,
    measured_rate_hz,
    nearest_usual_rate,
    snapped,
    uneven_times,
    without_rounding,
)
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.media import write_video

WHOLE = [Fraction(rate) for rate in (1, 24, 25, 30, 48, 50, 60, 100, 120, 240, 1000)]
NTSC = [rate * Fraction(1000, 1001) for rate in WHOLE]
RATES = st.fractions(min_value=Fraction(1, 2), max_value=1000, max_denominator=10**6)
PRECISIONS = st.fractions(min_value=0, max_value=10, max_denominator=10**6)


@given(rate=RATES, precision_hz=PRECISIONS)
@example(rate=Fraction(1, 2), precision_hz=Fraction(10))
def test_snapping_twice_is_snapping_once(rate: Fraction, precision_hz: Fraction) -> None:
    once = snapped(rate, precision_hz)
    assert snapped(once, precision_hz) == once


@given(rate=RATES, precision_hz=PRECISIONS)
def test_snapping_moves_rate_by_no_more_than_precision(rate: Fraction, precision_hz: Fraction) -> None:
    found = snapped(rate, precision_hz)
    assert abs(found - rate) <= precision_hz
    assert found in {rate, nearest_usual_rate(rate)}


@given(rate=RATES, number=st.integers(1, 1000))
def test_no_usual_rate_is_nearer_than_nearest(rate: Fraction, number: int) -> None:
    distance = abs(nearest_usual_rate(rate) - rate)
    assert distance <= min(abs(number - rate), abs(number * Fraction(1000, 1001) - rate))


@pytest.mark.parametrize("rate", [*WHOLE, *NTSC])
def test_usual_rates_stay(rate: Fraction) -> None:
    assert nearest_usual_rate(rate) == snapped(rate, Fraction(0)) == without_rounding(float(rate)) == rate
    for _ in range(3):
        assert without_rounding(float(np.nextafter(float(rate), np.inf))) == rate


def test_another_rate_is_left_alone() -> None:
    assert snapped(Fraction("27.3"), Fraction("0.02")) == Fraction("27.3")
    assert measured_rate_hz(np.arange(1000) / 27.3) == 27.3
    assert measured_rate_hz(np.round(np.arange(1000) / 27.3, 6)) == pytest.approx(27.3, rel=1e-7)


@given(
    rate=st.sampled_from([*WHOLE, *NTSC]),
    start_s=st.floats(0.0, 86_400.0),
    num_frames=st.integers(2, 500),
)
def test_even_times_give_exact_rate(rate: Fraction, start_s: float, num_frames: int) -> None:
    time_s = start_s + np.arange(num_frames) / float(rate)
    assert measured_rate(time_s) == rate
    assert measured_rate_hz(time_s) == float(rate)


@given(
    rate=st.sampled_from([rate for rate in (*WHOLE, *NTSC) if rate <= 240]),
    tick_hz=st.sampled_from([1000, 10_240, 90_000, 10**6]),
    dropped=st.sets(st.integers(1, 498), max_size=3),
)
def test_rounded_times_with_gaps_give_exact_rate(rate: Fraction, tick_hz: int, dropped: set[int]) -> None:
    frames = np.delete(np.arange(4000), sorted(dropped))
    assert measured_rate(np.rint(frames / float(rate) * tick_hz) / tick_hz) == rate


def test_24_frames_second_on_clock_of_60_hz() -> None:
    """Intervals of 2 and 3 ticks by turns; then with a gap of half a second, which does not count."""
    ticks = np.floor(np.arange(241) * 2.5)
    assert measured_rate_hz(ticks / 60.0) == 24.0
    ticks[120:] += 30
    assert measured_rate_hz(ticks / 60.0) == pytest.approx(24.0, rel=2e-3)


@pytest.mark.parametrize("rate_hz", [1.0, 25.0, 1000.0])
def test_times_that_jitter(rate_hz: float) -> None:
    jitter = np.random.default_rng(5).uniform(-0.2, 0.2, 1000)
    assert measured_rate_hz((np.arange(1000) + jitter) / rate_hz) == pytest.approx(rate_hz, rel=1e-3)


def test_many_gaps_and_jitter_do_not_make_any_rate_whole_one() -> None:
    rng = np.random.default_rng(1)
    frames = np.flatnonzero(rng.random(100) > 0.3)
    assert measured_rate_hz((frames + rng.uniform(-0.2, 0.2, len(frames))) / 1.4) == pytest.approx(1.4, rel=0.05)


def test_one_frame_and_frames_without_rate() -> None:
    assert measured_rate(np.zeros(1)) == 25
    assert measured_rate(np.zeros(3)) is None
    assert measured_rate_hz(np.zeros(3)) == np.inf


@pytest.mark.parametrize("ending", ["mp4", "mkv", "avi", "ts", "mov"])
@pytest.mark.parametrize("rate", [24, 25, 30, 50, 60, 120, *(Fraction(1000 * n, 1001) for n in (24, 30, 60, 120))])
def test_rate_of_video_file(tmp_path: Path, ending: str, rate: int | Fraction) -> None:
    codec, pix_fmt = ("mjpeg", "yuvj420p") if ending == "avi" else ("libx264", "yuv420p")
    # Matroska's times are whole milliseconds: 90 frames can't tell 120 Hz from 119.88 Hz.
    num_frames = 250 if ending == "mkv" else 60
    path = write_video(tmp_path / f"a.{ending}", num_frames, (32, 32), codec, rate_hz=rate, pix_fmt=pix_fmt)
    found = probe(path)
    assert isinstance(found, VideoInfo)
    assert found.frame_rate_hz == float(rate)


REGULAR_S = np.arange(300) / 29.97


def test_regular_and_rounded_times_are_not_worth_word() -> None:
    assert uneven_times(REGULAR_S) == []
    assert uneven_times(np.round(REGULAR_S, 3)) == []
    assert uneven_times(np.floor(np.arange(200) * 60 / 24) / 60) == []  # 24 Hz on a clock of 60 Hz
    assert uneven_times(np.array([0.0])) == []
    assert uneven_times(np.array([0.0, 5.0])) == []


def test_gaps_are_counted_and_placed() -> None:
    (warning,) = uneven_times(np.delete(REGULAR_S, [100, 101, 102, 200]))
    assert warning.code == "frames_dropped"
    assert warning.message == "4 frames are missing, at 3.30, 6.64 s; the longest gap is 0.133 s."
    (one,) = uneven_times(np.delete(REGULAR_S, 50))
    assert one.message.startswith("1 frame is missing, at 1.63 s;")
    (many,) = uneven_times(np.delete(REGULAR_S, range(10, 290, 14)))
    assert many.message.startswith("20 frames are missing, at 0.30, 0.77, 1.23, 1.70, 2.17 s and 15 more times;")


def test_frames_at_almost_one_time_are_said() -> None:
    (warning,) = uneven_times(np.sort(np.append(REGULAR_S, REGULAR_S[90] + 0.002)))
    assert warning.code == "frames_too_close"
    assert warning.message == "1 frame follows the one before at once, at 3.01 s."


def test_rate_that_varies_is_said_once() -> None:
    intervals_s = np.random.default_rng(0).exponential(0.04, 300)
    (warning,) = uneven_times(np.cumsum(intervals_s))
    assert warning.code == "frame_rate_varies"


@pytest.mark.parametrize("factor", [1.5, 0.5])
def test_jitter_is_no_gap(factor: float) -> None:
    intervals_s = np.full(100, 0.04)
    intervals_s[40] *= factor
    assert uneven_times(np.cumsum(intervals_s)) == []
