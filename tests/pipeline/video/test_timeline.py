import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.run.engine.stage import FrameCut
from pipeline.video.timeline import (
    frames_in,
    recorded_stretches,
    session_timebase,
    span_s,
)


@given(
    rate_hz=st.sampled_from([23.976, 25.0, 30000 / 1001, 50.0, 59.94, 119.88]),
    num_frames=st.integers(1, 400),
    chunk_frames=st.integers(1, 130),
    phase=st.floats(-0.49, 0.49),
)
def test_every_frame_is_in_exactly_one_chunk(rate_hz: float, num_frames: int, chunk_frames: int, phase: float) -> None:
    times = FrameTimes((np.arange(num_frames) + phase) / rate_hz)
    timebase = Timebase(0.0, rate_hz, num_frames)
    ranges = list(FrameCut(range(num_frames), (range(num_frames),), chunk_frames))
    assert [frame for one in ranges for frame in one] == list(range(num_frames))
    spans = [span_s(timebase, one.start, one.stop) for one in ranges]
    assert [frame for span in spans for frame in frames_in(times, *span)] == list(range(num_frames))
    if chunk_frames < num_frames and abs(phase) < 0.4:
        assert len(frames_in(times, *spans[0])) == chunk_frames


def test_pause_of_hours_is_no_stretch() -> None:
    times = [np.arange(50) / 25.0, 40_000.0 + np.arange(50) / 25.0]
    timebase = session_timebase({str(k): FrameTimes(time_s) for k, time_s in enumerate(times)})
    assert recorded_stretches(timebase, times) == (range(51), range(999_999, 1_000_050))
    assert recorded_stretches(timebase, []) == (range(1),)


@given(
    start_s=st.lists(st.floats(0.0, 900.0), min_size=1, max_size=5),
    chunk_frames=st.integers(1, 130),
    wanted=st.tuples(st.integers(0, 9000), st.integers(1, 9000)).map(lambda one: range(one[0], one[0] + one[1])),
)
def test_every_frame_is_in_chunk_whatever_pauses(start_s: list[float], chunk_frames: int, wanted: range) -> None:
    """Frame times of cameras that record for two seconds at different times."""
    times = {str(k): FrameTimes(one_s + np.arange(20) / 10.0) for k, one_s in enumerate(start_s)}
    timebase = session_timebase(times)
    stretches = recorded_stretches(timebase, (one.time_s for one in times.values()))
    ranges = FrameCut(range(timebase.num_frames), stretches, chunk_frames)
    frames = [frame for one in ranges for frame in one]
    assert frames == sorted(set(frames))
    spans = [span_s(timebase, one.start, one.stop) for one in ranges]
    for one in times.values():
        assert [frame for span in spans for frame in frames_in(one, *span)] == list(range(20))
    assert len(frames) <= len(start_s) * (620 + 22 + 2 * chunk_frames)  # pauses of a minute are not cut out

    inside = wanted if wanted.start < timebase.num_frames else range(timebase.num_frames)
    inside = range(inside.start, min(inside.stop, timebase.num_frames))
    cut = FrameCut(inside, stretches, chunk_frames)
    worked_on = {frame for one in cut for frame in one}
    assert worked_on <= set(inside)
    assert {frame for one in cut.parts for frame in one} <= worked_on


def test_timebase_takes_fastest_camera_and_longest_span() -> None:
    times = {
        "slow": FrameTimes(np.arange(50) / 25.0),
        "fast": FrameTimes(np.arange(59) / 30.0 + 0.1),
    }
    timebase = session_timebase(times)
    assert timebase.start_time_s == 0.0
    assert timebase.frame_rate_hz == 30.0
    assert timebase.num_frames == round((0.1 + 58 / 30) * 30) + 1


def test_rate_survives_rounded_timestamps_and_gaps() -> None:
    frames = np.delete(np.arange(200), [50, 51, 52, 120])
    rounded = FrameTimes(np.round(frames / 60.0, 3))
    assert session_timebase({"a": rounded}).frame_rate_hz == 60.0
