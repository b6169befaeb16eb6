"""Recordings in several files: as one video in every respect, to the bit."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pipeline.video.decode import decode
from pipeline.video.info import Timecode, VideoInfo
from pipeline.video.joined import join_parts, seam_problems
from pipeline.video.playback.proxy import make_proxy_in_child
from pipeline.video.probe import probe
from tests.pipeline.media import cut_at_keyframes, write_video

NUM_FRAMES = 40
CLOSED = {"g": "8", "keyint_min": "8", "sc_threshold": "0", "bf": "2"}


def probed(path: Path) -> VideoInfo:
    found = probe(path)
    assert isinstance(found, VideoInfo)
    return found


@pytest.fixture(scope="module", params=["mp4", "mov", "ts"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> VideoInfo:
    path = tmp_path_factory.mktemp("whole") / f"whole.{request.param}"
    return probed(write_video(path, NUM_FRAMES, options=CLOSED))


@pytest.fixture(scope="module")
def joined(whole: VideoInfo, tmp_path_factory: pytest.TempPathFactory) -> VideoInfo:
    folder = tmp_path_factory.mktemp("parts")
    names = [folder / f"GX0{number}0119{whole.path.suffix}" for number in (1, 2, 3)]
    parts = [probed(path) for path in cut_at_keyframes(whole.path, names, num_keyframes=2)]
    assert [part.num_frames for part in parts] == [16, 16, 8]
    assert list(seam_problems(parts)) == []
    return join_parts(parts)


def pictures(video: VideoInfo, start: int, stop: int, only: list[int] | None = None) -> list[tuple[int, bytes]]:
    return [(number, image_rgb.tobytes()) for number, image_rgb in decode(video, start, stop, only=only)]


def test_times_and_keyframes_are_those_of_whole(whole: VideoInfo, joined: VideoInfo) -> None:
    np.testing.assert_array_equal(joined.time_s, whole.time_s)
    np.testing.assert_array_equal(
        np.isin(joined.pts, joined.keyframe_pts).nonzero()[0], np.isin(whole.pts, whole.keyframe_pts).nonzero()[0]
    )
    assert joined.frame_rate_hz == whole.frame_rate_hz
    assert joined.browser_media_type is None
    assert joined.paths == tuple(part.path for part in joined.parts)


@pytest.fixture(scope="module")
def expected(whole: VideoInfo) -> list[tuple[int, bytes]]:
    """Pictures of the whole."""
    return pictures(whole, 0, NUM_FRAMES)


@pytest.mark.parametrize(
    "span",
    [
        *((0, NUM_FRAMES), (15, 17), (39, 45)),
        *(pytest.param(span, marks=pytest.mark.slow) for span in ((3, 15), (16, 32), (31, 40), (-5, 1))),
    ],
)
def test_pictures_are_those_of_whole(
    joined: VideoInfo, expected: list[tuple[int, bytes]], span: tuple[int, int]
) -> None:
    assert pictures(joined, *span) == expected[max(span[0], 0) : span[1]]


def test_chosen_pictures_are_those_of_whole(joined: VideoInfo, expected: list[tuple[int, bytes]]) -> None:
    for only in ([0, 8, 16, 24, 32], [1, 15, 16, 39], [20]):
        assert pictures(joined, 0, NUM_FRAMES, only=only) == [expected[number] for number in only]


def test_proxies_are_those_of_whole(whole: VideoInfo, joined: VideoInfo, tmp_path: Path) -> None:
    frames: list[str] = []
    for name, video in (("whole", whole), ("joined", joined)):
        make_proxy_in_child(video, video.time_s, tmp_path / f"{name}.mp4", partial(frames.append, name))
    assert frames == ["whole"] * NUM_FRAMES + ["joined"] * NUM_FRAMES
    assert (tmp_path / "joined.mp4").read_bytes() == (tmp_path / "whole.mp4").read_bytes()


def test_damaged_frame_has_its_number_in_whole(joined: VideoInfo) -> None:
    part = joined.parts[1]
    missing = replace(part, pts=np.append(part.pts, part.pts[-1] + 512), time_s=np.append(part.time_s, 1.0))
    damaged: list[int] = []
    broken = join_parts([joined.parts[0], missing, joined.parts[2]])
    assert len(list(decode(broken, 0, 50, damaged.append))) == NUM_FRAMES
    assert damaged == [32]


def test_seams_of_other_pictures_are_refused(joined: VideoInfo, tmp_path: Path) -> None:
    others = {
        "codec is mpeg4, not h264": write_video(tmp_path / "codec.mp4", 8, codec="mpeg4"),
        "it has 80 x 48 pixels, not 64 x 48": write_video(tmp_path / "size.mp4", 8, (80, 48)),
        "it has 50 frames a second, not 25": write_video(tmp_path / "rate.mp4", 8, rate_hz=50),
    }
    for difference, path in others.items():
        (problem,) = seam_problems([joined.parts[0], probed(path)])
        assert (problem.code, problem.file) == ("parts_differ", path.name)
        assert difference in problem.message
    for turned in (replace(joined.parts[1], rotation_deg=180), replace(joined.parts[1], is_mirrored=True)):
        assert [problem.code for problem in seam_problems([joined.parts[0], turned])] == ["parts_differ"]


@pytest.mark.parametrize(
    ("between_s", "is_gap"), [(0.64, False), (0.68, False), (1.64, True), (60.0, True), (0.0, False), (-3.0, False)]
)
@pytest.mark.parametrize("start_s", [3600.0, 86_399.9])
def test_gaps_are_found_by_timecode(joined: VideoInfo, between_s: float, is_gap: bool, start_s: float) -> None:
    first = replace(joined.parts[0], timecode=Timecode(start_s, 25.0))
    second = replace(joined.parts[1], timecode=Timecode((start_s + between_s) % 86_400, 25.0))
    problems = list(seam_problems([first, second]))
    assert [problem.code for problem in problems] == ["parts_gap"] * is_gap
    if is_gap:
        assert f"{between_s - 0.64:.1f} s are missing" in problems[0].message


@pytest.mark.parametrize(("is_drop_frame", "day_s"), [(False, 86_486.4), (True, 86_399.9136)])
def test_gap_across_midnight_is_found_by_frames_of_day(joined: VideoInfo, is_drop_frame: bool, day_s: float) -> None:
    clock = Timecode(day_s - 0.1, 30_000 / 1001, is_drop_frame)
    first = replace(joined.parts[0], timecode=clock)
    for between_s, sentence in ((0.64, None), (1.64, "1.0 s are missing"), (60.0, "59.4 s are missing")):
        second = replace(joined.parts[1], timecode=replace(clock, time_s=between_s - 0.1))
        messages = [problem.message for problem in seam_problems([first, second])]
        assert len(messages) == (sentence is not None)
        assert all(sentence in message for message in messages if sentence)


@pytest.mark.parametrize(("between_s", "is_gap"), [(0.0, False), (1.0, False), (2.0, False), (9.0, True)])
def test_gaps_are_found_by_times_of_creation(joined: VideoInfo, between_s: float, is_gap: bool) -> None:
    first = replace(joined.parts[0], created_s=1.7e9)
    second = replace(joined.parts[1], created_s=1.7e9 + between_s)
    assert [problem.code for problem in seam_problems([first, second])] == ["parts_gap"] * is_gap
