"""How stages cut time; that they give the library's files is tested end to end."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from pipeline.data import Timebase
from pipeline.video.timeline import chunk_ranges
from worker.stages import span_s


@given(
    num_frames=st.integers(1, 500),
    chunk_frames=st.integers(1, 200),
    rate_hz=st.sampled_from([24.0, 25.0, 30000 / 1001, 60.0, 119.88]),
    start_s=st.floats(-10, 1e6),
)
def test_spans_are_the_library_s(num_frames: int, chunk_frames: int, rate_hz: float, start_s: float) -> None:
    timebase = Timebase(start_s, rate_hz, num_frames)
    edges = [*range(0, num_frames, chunk_frames), num_frames]
    assert [span_s(timebase, start, stop) for start, stop in pairwise(edges)] == chunk_ranges(timebase, chunk_frames)
