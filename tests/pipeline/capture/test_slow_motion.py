import numpy as np
import pytest

from pipeline.capture.clock import slow_motion
from pipeline.core.data.cameras import FrameTimes


def found(lengths: dict[str, tuple[float, float]], stated: tuple[str, ...] = ()) -> dict[str, tuple[float, float]]:
    """Filmed and stored rate of each video that seems to be slow motion, of videos of some seconds and rates."""
    times = {name: FrameTimes(np.arange(round(length_s * hz)) / hz) for name, (length_s, hz) in lengths.items()}
    files = {name: f"{name}.mp4" for name in lengths if name not in stated}
    findings = slow_motion(times, files)
    for finding in findings:
        assert finding.message.startswith(f"{finding.camera}.mp4 lasts ")
    return {str(finding.camera): (finding.evidence["filmed_hz"], finding.evidence["stored_hz"]) for finding in findings}


@pytest.mark.parametrize(
    ("stored_hz", "filmed_hz"), [(30.0, 120.0), (30.0, 240.0), (24.0, 120.0), (25.0, 50.0), (30.0, 960.0)]
)
def test_slow_motion_is_named_with_both_rates(stored_hz: float, filmed_hz: float) -> None:
    length_s = 10.3 * filmed_hz / stored_hz
    lengths = {"a": (10.0, 60.0), "b": (10.2, 60.0), "c": (length_s, stored_hz), "d": (9.9, 50.0)}
    assert found(lengths) == {"c": pytest.approx((filmed_hz, stored_hz))}


def test_several_and_one_of_two() -> None:
    lengths = {"a": (10.0, 60.0), "b": (40.5, 30.0), "c": (10.0, 60.0), "d": (79.0, 30.0)}
    assert found(lengths) == {"b": pytest.approx((120.0, 30.0)), "d": pytest.approx((240.0, 30.0))}
    assert found({"a": (5.0, 60.0), "b": (20.0, 30.0)}) == {"b": pytest.approx((120.0, 30.0))}


def test_other_lengths_are_no_slow_motion() -> None:
    assert found({"a": (10.0, 60.0), "b": (33.0, 30.0), "c": (10.5, 60.0)}) == {}  # no whole number of times
    assert found({"a": (10.0, 60.0), "b": (14.0, 30.0)}) == {}
    assert found({"a": (10.0, 30.0), "b": (40.0, 30.0), "c": (40.0, 30.0), "d": (40.0, 30.0)}) == {}  # one is short
    assert found({"a": (1.0, 60.0), "b": (40.0, 60.0)}) == {}  # 2400 Hz
    assert found({"a": (10.0, 60.0), "b": (40.0, 30.0)}, stated=("b",)) == {}
