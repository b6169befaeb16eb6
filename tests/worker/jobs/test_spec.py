"""What a spec refuses of a session."""

from pipeline.config import MAX_OUTPUT_FRAMES
from worker.jobs.spec import JobSpec


def test_all_that_a_session_does_not_allow_is_said_at_once() -> None:
    spec = JobSpec(smoothing="butterworth", cutoff_hz=12.5, exports=("bvh", "c3d"))
    assert {field: code for field, (code, _) in spec.problems(65_536, 25.0).items()} == {
        "cutoff_hz": "cutoff_range",
        "exports": "too_long_for_c3d",
    }
    assert spec.problems(65_535, 25.1) == {}
    assert JobSpec(exports=("trc",)).problems(100_000, 25.0) == {}


def test_frames_at_another_rate_are_bounded() -> None:
    """A session of three hours at 24 Hz, which has 2.6 million frames at 240 Hz."""
    spec = JobSpec(output_rate_hz=240.0)
    assert {field: code for field, (code, _) in spec.problems(3 * 3600 * 24, 24.0).items()} == {
        "output_rate_hz": "too_many_frames"
    }
    assert spec.problems(MAX_OUTPUT_FRAMES // 10, 24.0) == {}
    assert spec.problems(MAX_OUTPUT_FRAMES // 10 + 2, 24.0)
    assert JobSpec(output_rate_hz=240.0, frame_range=(0, 1000)).problems(3 * 3600 * 24, 24.0) == {}
