"""Times of keypoints: timestamps, the numbers of files, and rates."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.validation.simulation.scenes import Simulation
from tests.pipeline.capture.keypoint_scenes import messages, opened, problems_of, split_frames


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda rows: rows[:1], "timestamps_missing", "have no time"),
        (lambda rows: ["camera,frame,when", *rows[1:]], "timestamps_invalid", "columns camera, frame, time_s"),
        (lambda rows: [*rows, rows[1]], "timestamps_invalid", "a second time"),
        (lambda rows: [*rows[:2], rows[2].rpartition(",")[0] + ",soon"], "timestamps_invalid", "Line 3"),
        (lambda rows: [*rows[:2], rows[2].rpartition(",")[0] + ",nan"], "timestamps_invalid", "line 3"),
        (lambda rows: [*rows[:2], rows[2].rpartition(",")[0] + ",-1"], "timestamps_invalid", "line 3"),
        (lambda rows: [*rows[:2], rows[2].rpartition(",")[0] + ",inf"], "timestamps_invalid", "line 3"),
        (lambda rows: [*rows[:2], rows[2].rpartition(",")[0] + ",0", *rows[3:]], "timestamps_order", "ascend"),
    ],
)
def test_bad_timestamps(scene: Path, change: Callable[[list[str]], list[str]], code: str, words: str) -> None:
    path = scene / "timestamps.csv"
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
    problems = problems_of(scene)
    assert list(problems) == [code]
    assert words in problems[code]


@pytest.mark.parametrize("start_s", [3700, 1_700_000_000, 1_700_000_000_000])
def test_times_since_1970_get_hint_that_helps(scene: Path, start_s: int) -> None:
    path = scene / "timestamps.csv"
    head, *rows = path.read_text().splitlines()
    times = [(row.rpartition(",")[0], float(row.rpartition(",")[2])) for row in rows]
    path.write_text("\n".join([head, *(f"{of},{start_s + time_s!r}" for of, time_s in times)]) + "\n")
    problems = problems_of(scene)
    assert list(problems) == ["timestamps_start"]
    message = problems["timestamps_start"]
    assert "Times must count from 0" in message
    assert message.endswith("Subtract the time at which the capture started.")


def test_rows_may_come_in_any_order(scene: Path, simulation: Simulation) -> None:
    path = scene / "timestamps.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *reversed(rows)]) + "\n")
    camera = simulation.cameras[0].name
    np.testing.assert_array_equal(opened(scene).times[camera].time_s, simulation.times[camera].time_s)


@pytest.mark.parametrize("rate_hz", [1.0, 1000.0])
def test_timestamps_at_limits_of_rates_are_taken(scene: Path, rate_hz: float) -> None:
    rows = [
        f"{folder.name},{int(path.name[6:18])},{10.0 + int(path.name[6:18]) / rate_hz!r}"
        for folder in sorted((scene / "keypoints").iterdir())
        for path in sorted(folder.iterdir())
    ]
    (scene / "timestamps.csv").write_text("\n".join(["camera,frame,time_s", *rows]) + "\n")
    assert opened(scene).timebase.frame_rate_hz == rate_hz


def test_one_clock_only_and_sane_one(scene: Path) -> None:
    assert "two_clocks" in problems_of(scene, frame_rate_hz=30.0)
    assert "frame_rate" in problems_of(scene, timed=False, frame_rate_hz=0.0)


def retime(scene: Path, time_s: Callable[[int], float], cameras: slice = slice(None)) -> None:
    """Change the frame times of some cameras."""
    chosen = sorted((scene / "keypoints").iterdir())[cameras]
    head, *rows = (scene / "timestamps.csv").read_text().splitlines()
    others = [row for row in rows if row.split(",")[0] not in {folder.name for folder in chosen}]
    ours = [
        f"{folder.name},{int(path.name[6:18])},{time_s(number)!r}"
        for folder in chosen
        for number, path in enumerate(sorted(folder.iterdir()))
    ]
    (scene / "timestamps.csv").write_text("\n".join([head, *others, *ours]) + "\n")


def test_rate_of_uneven_times_is_their_mean(scene: Path) -> None:
    """Intervals of 2 and 3 ticks of a 60 Hz clock, whose median is 20 or 30 Hz."""
    retime(scene, lambda number: int(2.5 * number) / 60)
    assert opened(scene).timebase.frame_rate_hz == pytest.approx(24.0, rel=0.02)


def test_rate_of_times_rounded_to_milliseconds(scene: Path) -> None:
    """The median interval is 33 ms, which would be 30.3 Hz."""
    retime(scene, lambda number: round(number / 30, 3))
    assert opened(scene).timebase.frame_rate_hz == 30.0


def test_rate_of_even_times(scene: Path) -> None:
    retime(scene, lambda number: number / 25)
    assert opened(scene).timebase.frame_rate_hz == 25.0


@pytest.mark.parametrize(
    ("last_s", "codes"),
    [(40_000.0, ["too_many_frames"]), (100_000.0, ["session_too_long"] * 3), (1e8, ["timestamps_start"])],
)
def test_last_time_that_is_far_too_late(scene: Path, last_s: float, codes: list[str]) -> None:
    retime(scene, lambda number: number / 100 if number < 20 else last_s + number / 100)
    with pytest.raises(InputError) as raised:
        opened(scene)
    assert [problem.code for problem in raised.value.problems] == codes
    assert all(problem.file == "timestamps.csv" and problem.hint for problem in raised.value.problems)
    if codes != ["timestamps_start"]:
        assert all(problem.camera and problem.field == "time_s" for problem in raised.value.problems)


def test_camera_whose_times_are_of_another_hour(scene: Path) -> None:
    retime(scene, lambda number: 3600.0 + number / 25, slice(1))
    assert list(problems_of(scene)) == ["no_overlap"]


@pytest.mark.parametrize("step_s", [5e-324, 1e-300, 1e-4])
def test_times_too_close_to_be_frames(scene: Path, step_s: float) -> None:
    retime(scene, lambda number: number * step_s)
    assert list(problems_of(scene)) == ["frame_rate"]


@pytest.mark.parametrize(
    ("number", "frame_rate_hz", "codes"),
    [
        (999_999_999_999_999, 25.0, {"session_too_long"}),
        (1_100_000, 1.0, {"session_too_long"}),
        (1_000_000, 1000.0, {"too_many_frames"}),
        (999_999, 1000.0, set()),
    ],
)
def test_numbers_of_files_are_times_too(scene: Path, number: int, frame_rate_hz: float, codes: set[str]) -> None:
    for camera in range(3):
        last = split_frames(scene, camera)[-1]
        last.rename(last.with_name(f"frame_{number:015d}_keypoints.json"))
    if not codes:
        assert opened(scene, timed=False, frame_rate_hz=frame_rate_hz).timebase.num_frames == number + 1
        return
    with pytest.raises(InputError) as raised:
        opened(scene, timed=False, frame_rate_hz=frame_rate_hz)
    assert {problem.code for problem in raised.value.problems} == codes
    assert all(problem.camera and problem.file and problem.hint for problem in raised.value.problems)


def renumbered(scene: Path, number: Callable[[int], int]) -> None:
    """Rename the files of all frames."""
    for path in sorted((scene / "keypoints").rglob("*_keypoints.json"), reverse=True):
        path.rename(path.with_name(f"frame_{number(int(path.name[6:18])):012d}_keypoints.json"))


@pytest.mark.parametrize("first", [1, 36, 5000])
def test_open_keypoints_begins_with_first_frame(scene: Path, first: int) -> None:
    before = opened(scene, timed=False, frame_rate_hz=25.0)
    renumbered(scene, lambda number: number + first)
    session = opened(scene, timed=False, frame_rate_hz=25.0)
    assert session.timebase.start_time_s == first / 25
    assert session.timebase.first_source_frame == first
    assert session.timebase.num_frames == before.timebase.num_frames
    for camera, times in session.times.items():
        np.testing.assert_allclose(times.time_s, before.times[camera].time_s + first / 25, atol=1e-9)
        np.testing.assert_array_equal(session.detections[camera].frame, before.detections[camera].frame)


def test_open_keypoints_begins_with_earliest_number(scene: Path) -> None:
    renumbered(scene, lambda number: number + 1000)
    for path in split_frames(scene)[:7]:
        path.unlink()
    session = opened(scene, timed=False, frame_rate_hz=50.0)
    late = split_frames(scene)[0].parent.name
    assert (session.timebase.start_time_s, session.timebase.first_source_frame) == (20.0, 1000)
    assert session.times[late].time_s[0] == 1007 / 50


def test_open_keypoints_timestamps_begin_with_first_time(scene: Path) -> None:
    renumbered(scene, lambda number: number + 700)
    path = scene / "timestamps.csv"
    head, *rows = path.read_text().splitlines()
    parts = [row.split(",") for row in rows]
    moved = [f"{camera},{int(frame) + 700},{float(time_s) + 20.0!r}" for camera, frame, time_s in parts]
    path.write_text("\n".join([head, *moved]) + "\n")
    session = opened(scene)
    first_s = min(float(times.time_s[0]) for times in session.times.values())
    last_s = max(float(times.time_s[-1]) for times in session.times.values())
    timebase = session.timebase
    assert timebase.start_time_s == first_s > 20.0
    assert timebase.first_source_frame == 700
    assert timebase.num_frames == round((last_s - first_s) * timebase.frame_rate_hz) + 1


def test_open_keypoints_refuses_times_since_1970(scene: Path) -> None:
    renumbered(scene, lambda number: 1_700_000_000_000 + 40 * number)
    (message,) = problems_of(scene, timed=False, frame_rate_hz=25.0).values()
    assert "has the number 1700000000000" in message
    assert "If the numbers are times, give timestamps." in message


def test_open_keypoints_reports_milliseconds_as_numbers(scene: Path) -> None:
    renumbered(scene, lambda number: 40 * number)
    (warning,) = messages(opened(scene, timed=False, frame_rate_hz=25.0))
    assert warning == "Frame numbers are at least 40 apart, which is 1.6 s at 25 Hz."
