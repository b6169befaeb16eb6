"""What a spec refuses of a session."""

from worker.jobs.spec import JobSpec


def test_all_that_a_session_does_not_allow_is_said_at_once() -> None:
    spec = JobSpec(smoothing="butterworth", cutoff_hz=12.5, exports=("bvh", "c3d"))
    assert {field: code for field, (code, _) in spec.problems(65536, 25.0).items()} == {
        "cutoff_hz": "cutoff_range",
        "exports": "too_long_for_c3d",
    }
    assert spec.problems(65535, 25.1) == {}
    assert JobSpec(exports=("trc",)).problems(100_000, 25.0) == {}
