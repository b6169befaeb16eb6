"""Check of a session by its people: declared clocks, and cameras that hang turned."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture.synchronization.remaining import _agreed_s
from pipeline.core.data.cameras import FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.findings import Finding
from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.local import reconstruct
from pipeline.run.session_check import check_session
from pipeline.run.session_check.check_session import _affordable, _spans, check_clocks, hanging_cameras
from pipeline.validation.simulation.motion.script import Gesture
from tests.cases import slow_but
from tests.pipeline.capture.synchronization.conftest import Take, alone, cut_take, shortened
from tests.pipeline.capture.synchronization.test_session_clocks import session_of

PERIOD_S = 0.04


@pytest.fixture(scope="module")
def take() -> Take:
    return cut_take(shortened("room", 6.0), 4, (0, 0, 0))


def shifted(take: Take, frames: float, camera: int = 1) -> Take:
    """Declare that a camera took its frames later than it did."""
    name = take.cameras[camera].name
    times = {**take.times, name: FrameTimes(take.times[name].time_s + frames * PERIOD_S)}
    return replace(take, times=times)


def findings(take: Take) -> list[Finding]:
    session = session_of(take)
    return list(check_clocks(session, lambda frames: [session.detections], session.joints, session.stretches))


@pytest.mark.parametrize("frames", slow_but([0.8], [0.8, -0.8]))
def test_camera_that_is_late_is_named_with_its_offset(take: Take, frames: float) -> None:
    (found,) = findings(shifted(take, frames))
    assert (found.code, found.severity, found.camera) == ("clocks_disagree", "warning", take.cameras[1].name)
    assert found.evidence["late_frames"] == pytest.approx(-frames, abs=0.1)
    assert found.evidence["late_s"] == pytest.approx(-frames * PERIOD_S, abs=0.004)
    assert "earlier" if frames > 0 else "later" in found.message
    assert "sync: auto" in str(found.hint)
    # The hint mends it.
    mended = shifted(take, frames + found.evidence["late_s"] / PERIOD_S)
    assert findings(mended) == []


def test_good_times_and_people_at_rest_are_no_findings(take: Take) -> None:
    assert findings(take) == []
    assert findings(shifted(take, 0.3)) == []
    assert findings(shifted(cut_take(alone(Gesture.IDLE, 4.0), 4, (0, 0, 0)), 3.0)) == []


@pytest.mark.slow
def test_reconstruction_says_so(take: Take) -> None:
    late = session_of(shifted(take, 1.0))
    codes = {}
    for sync in ("declared", "auto"):
        made = reconstruct(late, ReconstructionConfig(smoothing="none", sync=sync))
        codes[sync] = [one.code for one in made.check.findings]
    assert codes == {"declared": ["clocks_disagree"], "auto": []}


@pytest.mark.parametrize(
    ("late_frames", "agreed"),
    [
        ([0.0, 0.8], 0.0),
        ([0.0, 0.1, 0.2, 3.0], 0.1),
        ([1.0, 1.1, 0.0, 1.05], 1.05),
        ([0.0, 0.0, 1.0, 1.0], 0.0),
    ],
)
def test_times_are_compared_with_cameras_that_agree(late_frames: list[float], agreed: float) -> None:
    late_s = np.array(late_frames) * PERIOD_S
    assert _agreed_s(late_s, np.full(len(late_s), PERIOD_S)) == pytest.approx(agreed * PERIOD_S)


def test_crowds_are_looked_at_for_shorter_time_or_not_at_all(take: Take, monkeypatch: pytest.MonkeyPatch) -> None:
    late = shifted(take, 0.8)
    spent: list[int] = []

    def counted(cameras: object, times: object, bodies: Mapping[str, Detections], joints: object) -> tuple[()]:
        spent.append(sum(len(of.frame) for of in bodies.values()))
        return ()

    monkeypatch.setattr(check_session, "remaining_offsets", counted)
    monkeypatch.setattr(check_session, "_MAX_COMPARISONS", 1.0)
    session = session_of(late)
    needed = 1.0 / _affordable(
        session.times, session.detections, session.timebase.num_frames / session.timebase.frame_rate_hz
    )
    for share in (1.0, 0.8, 0.5):
        monkeypatch.setattr(check_session, "_MAX_COMPARISONS", share * needed)
        assert [found.code for found in findings(late)] == ([] if share > 0.5 else ["clocks_unchecked"])
    whole, part = spent  # three seconds of six are too short
    assert whole == sum(len(of.frame) for of in late.detections.values())
    assert part == pytest.approx(0.8 * whole, rel=0.05)


def test_minute_of_long_take_is_looked_at() -> None:
    assert _spans([range(0, 700), range(900, 1600)], 25.0) == [range(0, 700), range(900, 1600)]
    assert _spans([range(6000)], 25.0) == [range(750, 1250), range(2750, 3250), range(4750, 5250)]
    assert _spans([range(2900), range(3100, 6200)], 25.0) == [
        range(750, 1250),
        range(2750, 2900),
        range(3100, 3450),
        range(4950, 5450),
    ]


@pytest.mark.parametrize(
    ("turn_deg", "words"),
    [
        (180.0, "hangs upside down: its pictures are turned upright, by 180 degrees, before"),
        (90.0, "by 90 degrees counterclockwise"),
        (270.0, "by 90 degrees clockwise"),
        (137.0, "by 137 degrees counterclockwise"),
    ],
)
def test_turned_cameras_are_named_with_their_turn(turn_deg: float, words: str) -> None:
    (finding,) = hanging_cameras({"left": 0.0, "right": turn_deg})
    assert (finding.camera, finding.severity, finding.code) == ("right", "info", "camera_hangs_turned")
    assert words in finding.message
    assert finding.evidence == {"turn_deg": turn_deg}
