import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.data import FrameTimes, Timebase
from pipeline.video.timeline import chunk_ranges, frames_in, session_timebase, span_s


@given(
    rate_hz=st.sampled_from([23.976, 25.0, 30000 / 1001, 50.0, 59.94, 119.88]),
    num_frames=st.integers(1, 400),
    chunk_frames=st.integers(1, 130),
    phase=st.floats(-0.49, 0.49),
)
def test_every_frame_is_in_exactly_one_chunk(rate_hz: float, num_frames: int, chunk_frames: int, phase: float) -> None:
    times = FrameTimes((np.arange(num_frames) + phase) / rate_hz)
    timebase = Timebase(0.0, rate_hz, num_frames)
    ranges = chunk_ranges(timebase, chunk_frames)
    assert [frame for one in ranges for frame in one] == list(range(num_frames))
    spans = [span_s(timebase, one.start, one.stop) for one in ranges]
    assert [frame for span in spans for frame in frames_in(times, *span)] == list(range(num_frames))
    if chunk_frames < num_frames and abs(phase) < 0.4:
        assert len(frames_in(times, *spans[0])) == chunk_frames


def test_timebase_takes_the_fastest_camera_and_the_longest_span() -> None:
    times = {
        "slow": FrameTimes(np.arange(50) / 25.0),
        "fast": FrameTimes(np.arange(59) / 30.0 + 0.1),
    }
    timebase = session_timebase(times)
    assert timebase.start_time_s == 0.0
    np.testing.assert_allclose(timebase.frame_rate_hz, 30.0)
    assert timebase.num_frames == round((0.1 + 58 / 30) * 30) + 1


def test_rate_survives_rounded_timestamps_and_gaps() -> None:
    frames = np.delete(np.arange(200), [50, 51, 52, 120])
    rounded = FrameTimes(np.round(frames / 60.0, 3))
    np.testing.assert_allclose(session_timebase({"a": rounded}).frame_rate_hz, 60.0, rtol=2e-3)
