"""Sessions by timecode and by times of creation."""

import json
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from pipeline.capture import preflight
from pipeline.capture.preflight_record import Clock, Preflight, Recording
from pipeline.capture.session import open_session
from pipeline.capture.starts import starts_s
from pipeline.core.errors import InputError
from pipeline.video.info import Timecode, VideoInfo
from pipeline.video.probe import probe
from pipeline.video.properties.container_clocks import read_timecode
from tests.pipeline.capture.keypoint_scenes import messages
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.media import write_video
from tests.pipeline.video.properties.test_container_clocks import NTSC, write

# Numerators of 23.976, 29.97, 47.952 and 59.94 Hz.
NTSC_TICKS = (24_000, 30_000, 48_000, 60_000)
CREATED = "2024-05-01T10:00:03Z"


@pytest.fixture(scope="module")
def any_video(tmp_path_factory: pytest.TempPathFactory) -> VideoInfo:
    found = probe(write_video(tmp_path_factory.mktemp("video") / "a.mp4", 3))
    assert isinstance(found, VideoInfo)
    return found


def of_times(video: VideoInfo, times_s: Mapping[str, float]) -> dict[str, VideoInfo]:
    return {camera: replace(video, timecode=Timecode(one, 25.0), created_s=one) for camera, one in times_s.items()}


def test_starts_count_from_earliest_video(any_video: VideoInfo) -> None:
    videos = of_times(any_video, {"a": 3600.4, "b": 3600.0, "c": 3661.0})
    for clock in ("timecode", "creation_time"):
        found, problems = starts_s(videos, clock)
        assert problems == []
        assert found == pytest.approx({"a": 0.4, "b": 0.0, "c": 61.0})
    assert starts_s(videos, "declared")[0] == {"a": 0.0, "b": 0.0, "c": 0.0}


def test_timecode_passes_midnight(any_video: VideoInfo) -> None:
    videos = of_times(any_video, {"a": 86_399.0, "b": 2.0, "c": 86_390.0})
    assert starts_s(videos, "timecode")[0] == pytest.approx({"a": 9.0, "b": 12.0, "c": 0.0})
    assert starts_s(videos, "creation_time")[0]["a"] == pytest.approx(86_397.0)
    assert starts_s(of_times(any_video, {"a": 5.0}), "timecode")[0] == {"a": 0.0}


@pytest.mark.parametrize("rate", [*map(Fraction, (24, 25, 30, 50, 60)), *(Fraction(n, 1001) for n in NTSC_TICKS)])
@pytest.mark.parametrize("mark", [":", ";"])
def test_timecode_across_midnight_counts_frames_of_day(any_video: VideoInfo, rate: Fraction, mark: str) -> None:
    """One second before midnight, and one second and half a minute after it: no number is dropped in between."""
    texts = {"a": f"00:00:01{mark}00", "b": f"23:59:59{mark}00", "c": f"00:00:30{mark}06"}
    stated = {
        camera: replace(any_video, timecode=read_timecode(any_video.path, {"timecode": text}, rate))
        for camera, text in texts.items()
    }
    found, problems = starts_s(stated, "timecode")
    assert problems == []
    frames = {"a": 2 * round(rate), "b": 0, "c": 31 * round(rate) + 6}
    assert found == pytest.approx({camera: float(count / rate) for camera, count in frames.items()}, abs=1e-6)


def test_timecodes_of_several_rates_meet_at_midnight(any_video: VideoInfo) -> None:
    texts = {"a": ("23:59:58:00", NTSC), "b": ("23:59:59:00", Fraction(25)), "c": ("00:00:01:00", Fraction(24))}
    stated = {
        camera: replace(any_video, timecode=read_timecode(any_video.path, {"timecode": text}, rate))
        for camera, (text, rate) in texts.items()
    }
    assert starts_s(stated, "timecode")[0] == pytest.approx({"a": 0.0, "b": 1.002, "c": 3.002}, abs=1e-6)


def videos(folder: Path, **changes: str) -> list[Path]:
    """Videos of 29.97, 25 and 59.94 Hz, jam-synchronised: the second starts 0.2 s after the first."""
    stated = {"a": "10:00:00;00", "b": "10:00:00:04", "c": "10:00:00;06"} | changes
    rates = {"a": NTSC, "b": Fraction(25), "c": Fraction(60000, 1001)}
    for name, rate in rates.items():
        write(folder / f"{name}.mov", rate, timecode=stated[name], creation_time=CREATED)
    return [folder / f"{name}.mov" for name in rates]


def test_rates_of_cameras_meet_on_timecode(tmp_path: Path) -> None:
    cameras = calibration(tmp_path / "c.json", ["a", "b", "c"])
    session = open_session(videos(tmp_path), cameras, [Recording("c", offset_s=0.01)], clock="timecode")
    # Drop-frame timecode is 3.6 ms an hour behind the time of day.
    begin_s = (36_000 * 30 - 10 * 108) * 1001 / 30_000
    starts = {name: float(times.time_s[0]) for name, times in session.times.items()}
    assert starts["a"] == 0.0
    assert starts["b"] == pytest.approx(36_000.16 - begin_s, abs=1e-6)
    assert starts["c"] == pytest.approx(6 * 1001 / 60_000 + 0.01, abs=1e-6)
    np.testing.assert_allclose(np.diff(session.times["c"].time_s), 1001 / 60_000, atol=1e-6)
    assert session.timebase.frame_rate_hz == float(Fraction(60000, 1001))
    assert session.findings == ()


def test_times_of_creation_are_said_to_be_coarse(tmp_path: Path) -> None:
    cameras = calibration(tmp_path / "c.json", ["a", "b", "c"])
    session = open_session(videos(tmp_path), cameras, clock="creation_time")
    assert {float(times.time_s[0]) for times in session.times.values()} == {0.0}
    (warning,) = messages(session)
    assert "may be off from each other by a second" in warning


@pytest.mark.parametrize("clock", ["timecode", "creation_time"])
def test_videos_without_clock_are_all_named(tmp_path: Path, clock: Clock) -> None:
    paths = videos(tmp_path)
    for path in paths[1:]:
        path.unlink()
        write(path, Fraction(25))
    with pytest.raises(InputError) as raised:
        open_session(paths, calibration(tmp_path / "c.json", ["a", "b", "c"]), clock=clock)
    assert [(one.code, one.file, one.camera) for one in raised.value.problems] == [
        (f"no_{clock}", "b.mov", "b"),
        (f"no_{clock}", "c.mov", "c"),
    ]


def test_timecodes_that_do_not_overlap_are_named_as_such(tmp_path: Path) -> None:
    paths = videos(tmp_path, b="11:00:00:00")
    with pytest.raises(InputError, match="timecodes of the videos lie too far apart") as raised:
        open_session(paths, calibration(tmp_path / "c.json", ["a", "b", "c"]), clock="timecode")
    (problem,) = raised.value.problems
    assert (problem.code, problem.camera) == ("no_overlap", "b")


def test_check_of_session_records_its_clock(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--videos", *map(str, videos(tmp_path)), "--calibration"]
    words += [str(calibration(tmp_path / "c.json", ["a", "b", "c"])), "--clock", "timecode"]
    assert preflight.main(words) == 0
    checked = Preflight.from_json(json.loads(capsys.readouterr().out))
    assert checked.clock == "timecode"
    assert checked.cameras[0].start_time_s == 0.0
    assert set(get_args(Clock)) == {"declared", "timecode", "creation_time"}
