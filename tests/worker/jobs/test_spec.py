"""What a spec refuses of a session."""

from pipeline.export.c3d_file import MAX_FRAMES
from worker.jobs.spec import JobSpec


def test_all_that_a_session_does_not_allow_is_said_at_once() -> None:
    spec = JobSpec(smoothing="butterworth", cutoff_hz=12.5, exports=("bvh", "c3d"))
    assert {field: code for field, (code, _) in spec.problems(MAX_FRAMES + 1, 25.0).items()} == {
        "cutoff_hz": "cutoff_range",
        "exports": "too_long_for_c3d",
    }
    assert spec.problems(MAX_FRAMES, 25.1) == {}
    assert JobSpec(exports=("trc",)).problems(100_000, 25.0) == {}
