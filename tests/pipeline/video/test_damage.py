"""Videos with damaged bytes, changing sizes and unordered times: reported or rejected."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pipeline.core.errors import InputError, Problem
from pipeline.video.container import MAX_PIXELS
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.media import rewrite_packets, write_sizes, write_video

NUM_FRAMES = 48
SIZE_PX = (160, 120)

KINDS: dict[str, dict[str, Any]] = {
    "h264.mp4": {"codec": "libx264", "options": {"g": "12"}},
    "hevc.mp4": {"codec": "libx265", "options": {"x265-params": "keyint=12:log-level=0"}},
    "mjpeg.avi": {"codec": "mjpeg", "pix_fmt": "yuvj420p"},
    "vp9.webm": {"codec": "libvpx-vp9", "options": {"g": "12", "deadline": "realtime"}},
    "mpeg4.avi": {"codec": "mpeg4", "options": {"g": "12"}},
    "mpeg2.ts": {"codec": "mpeg2video", "options": {"g": "12"}},
    "av1.mkv": {"codec": "libsvtav1", "options": {"g": "12", "preset": "12"}},
    "ffv1.mkv": {"codec": "ffv1", "options": {"g": "1", "level": "3", "slicecrc": "1"}},
}


def probed(path: Path) -> VideoInfo:
    found = probe(path)
    assert isinstance(found, VideoInfo), found
    return found


def refused(path: Path) -> Problem:
    found = probe(path)
    assert isinstance(found, Problem), found
    return found


def refused_later(video: VideoInfo, start_frame: int = 0) -> Problem:
    with pytest.raises(InputError) as error:
        list(decode(video, start_frame, video.num_frames))
    (problem,) = error.value.problems
    assert problem.file == video.path.name
    return problem


def flip(path: Path, seed: int, num_bytes: int) -> Path:
    """Overwrite bytes in the middle half of a file."""
    rng = np.random.default_rng(seed)
    content = np.frombuffer(path.read_bytes(), np.uint8).copy()
    position = int(rng.integers(len(content) // 4, 3 * len(content) // 4))
    content[position : position + num_bytes] ^= rng.integers(1, 256, num_bytes, np.uint8)
    target = path.with_name(f"flipped-{seed}{path.suffix}")
    target.write_bytes(content.tobytes())
    return target


def by_time(path: Path) -> dict[int, np.ndarray]:
    """Decode pictures by timestamp with PyAV alone; pictures of damaged packets are missing."""
    found: dict[int, np.ndarray] = {}
    with av.open(str(path)) as container:
        container.streams.video[0].codec_context.thread_count = 1
        for packet in container.demux(video=0):
            try:
                frames = packet.decode()
            except av.FFmpegError:
                continue
            found |= {frame.pts: frame.to_ndarray(format="rgb24") for frame in frames if frame.pts is not None}
    return found


@pytest.mark.parametrize("name", KINDS)
def test_flipped_bytes_move_no_frame(tmp_path: Path, name: str) -> None:
    """Assert that each frame has the picture of its timestamp or is reported as damaged, and comes once."""
    good = write_video(tmp_path / name, NUM_FRAMES, SIZE_PX, **KINDS[name])
    for seed in range(6):
        video = probe(flip(good, seed, 40))
        if isinstance(video, Problem):
            assert video.file == f"flipped-{seed}{good.suffix}"
            continue
        damaged: list[int] = []
        expected, shown = by_time(video.path), []
        for number, image_rgb in decode(video, 0, video.num_frames, damaged.append):
            shown.append(number)
            np.testing.assert_array_equal(image_rgb, expected[int(video.pts[number])])
        assert shown == sorted(set(shown))
        assert damaged == sorted(set(damaged))
        assert {*shown, *damaged} == set(range(video.num_frames))


@pytest.mark.parametrize("name", ["h264.mp4", "mpeg4.avi", "ffv1.mkv", "av1.mkv"])
def test_damage_that_decoder_notices_is_told(tmp_path: Path, name: str) -> None:
    good = write_video(tmp_path / name, NUM_FRAMES, SIZE_PX, **KINDS[name])
    none: list[int] = []
    assert len(list(decode(probed(good), 0, NUM_FRAMES, none.append))) == NUM_FRAMES
    assert none == []
    told = 0
    for seed in range(5):
        video = probe(flip(good, seed, 60))
        if isinstance(video, VideoInfo):
            damaged: list[int] = []
            list(decode(video, 0, NUM_FRAMES, damaged.append))
            told += len(damaged) > 0
    assert told >= 3


def test_damage_is_told_by_range_that_it_lies_in(tmp_path: Path) -> None:
    video = probed(flip(write_video(tmp_path / "a.mp4", NUM_FRAMES, SIZE_PX, options={"g": "12", "bf": "0"}), 3, 60))
    whole: list[int] = []
    list(decode(video, 0, NUM_FRAMES, whole.append))
    assert whole
    cut: list[int] = []
    for start in range(0, NUM_FRAMES, 7):
        list(decode(video, start, start + 7, cut.append))
    assert cut == whole


def lose(*lost: int) -> Any:
    """Damage some packets so that they can't be decoded."""

    def change(number: int, packet: "av.Packet[Any]") -> "Iterable[av.Packet[Any]]":
        if number not in lost:
            return [packet]
        spoilt = av.Packet(b"\xff" * packet.size)
        spoilt.pts, spoilt.dts, spoilt.time_base = packet.pts, packet.dts, packet.time_base
        return [spoilt]

    return change


def test_frames_without_picture_leave_others_at_their_times(tmp_path: Path) -> None:
    good = write_video(tmp_path / "a.mkv", NUM_FRAMES, codec="mjpeg", pix_fmt="yuvj420p")
    video = probed(rewrite_packets(good, tmp_path / "lost.mkv", lose(20, 21, 33)))
    expected, damaged = by_time(good), list[int]()
    for number, image_rgb in decode(video, 0, NUM_FRAMES, damaged.append):
        np.testing.assert_array_equal(image_rgb, expected[int(video.pts[number])])
    assert damaged == [20, 21, 33]
    assert [number for number, _ in decode(video, 19, 23)] == [19, 22]
    assert [number for number, _ in decode(video, 20, 22)] == []


def test_keyframe_that_decodes_to_nothing_is_no_place_to_begin(tmp_path: Path) -> None:
    """Pictures after the damage are decoded from pictures before it, in all ranges."""
    good = write_video(tmp_path / "a.mkv", NUM_FRAMES, codec="mpeg4", options={"g": "12"})
    keyframe = int(np.searchsorted(probed(good).pts, probed(good).keyframe_pts[2]))
    video = probed(rewrite_packets(good, tmp_path / "lost.mkv", lose(keyframe)))
    whole = {number: image_rgb.copy() for number, image_rgb in decode(video, 0, NUM_FRAMES)}
    assert keyframe not in whole
    for number, image_rgb in decode(video, keyframe + 1, keyframe + 5):
        np.testing.assert_array_equal(image_rgb, whole[number])


SIZED: dict[str, tuple[str, dict[str, str]]] = {
    "a.ts": ("libx264", {"g": "12", "bf": "0"}),
    "b.mkv": ("libx264", {"g": "12", "bf": "0"}),
    "c.webm": ("libvpx-vp9", {"g": "12", "lag-in-frames": "0", "deadline": "realtime", "cpu-used": "8"}),
    "d.mkv": ("libx265", {"x265-params": "keyint=12:bframes=0:log-level=0"}),
    "e.avi": ("mpeg4", {"g": "12"}),
}


@pytest.mark.parametrize("name", SIZED)
def test_size_that_changes_is_refused_before_job(tmp_path: Path, name: str) -> None:
    problem = refused(write_sizes(tmp_path / name, [(64, 48), (96, 64)], 24, *SIZED[name]))
    assert (problem.code, problem.file) == ("video_changes_size", name)
    assert "from 64 x 48 to 96 x 64 pixels" in problem.message


@pytest.mark.parametrize("name", SIZED)
def test_size_that_changes_for_while_is_refused_when_it_is_seen(tmp_path: Path, name: str) -> None:
    video = probed(write_sizes(tmp_path / name, [(64, 48), (96, 64), (64, 48)], 24, *SIZED[name]))
    assert len(list(decode(video, 0, 20))) == 20
    for start in (0, 30):
        problem = refused_later(video, start)
        assert problem.code == "video_changes_size"
        assert "96 x 64" in problem.message


def test_pictures_beyond_limit_are_never_decoded(tmp_path: Path) -> None:
    size_px = (8704, 4352)
    assert size_px[0] * size_px[1] > MAX_PIXELS
    path = write_sizes(tmp_path / "a.mkv", [(64, 48), size_px, (64, 48)], 2, "mjpeg", {"strict": "unofficial"})
    video, damaged = probed(path), list[int]()
    assert [number for number, _ in decode(video, 0, 6, damaged.append)] == [0, 1, 4, 5]
    assert damaged == [2, 3]


def at_times(pts: Any) -> Any:
    """Give the k-th packet the time ``pts(k)``, as far as FFmpeg's decoding times allow."""

    def change(number: int, packet: "av.Packet[Any]") -> "Iterable[av.Packet[Any]]":
        packet.pts, packet.dts = pts(number), number - 100_000
        return [packet]

    return change


def of_times(folder: Path, pts: Any, num_frames: int = NUM_FRAMES) -> Path:
    good = write_video(folder / "good.mkv", num_frames, options={"g": "12", "bf": "0"})
    return rewrite_packets(good, folder / "times.mkv", at_times(pts))


def test_frames_that_repeat_time_are_left_out_and_counted(tmp_path: Path) -> None:
    video = probed(of_times(tmp_path, lambda k: 40 * (k - (k == 20) - (k == 30))))
    assert (video.num_frames, video.num_repeated) == (NUM_FRAMES - 2, 2)
    shown = {int(video.pts[number]) // 40: image_rgb.copy() for number, image_rgb in decode(video, 0, NUM_FRAMES)}
    good = by_time(tmp_path / "good.mkv")
    assert set(shown) == set(range(NUM_FRAMES)) - {20, 30}
    for number, image_rgb in shown.items():
        np.testing.assert_array_equal(image_rgb, good[40 * number])


@pytest.mark.parametrize(
    ("pts", "words"),
    [
        (lambda k: 40 * (k % 60), "60 of 120 frames have the timestamp of another frame"),
        (lambda k: 40 * (k % 60) + 20 * (k // 60), "go backwards near"),
        (lambda k: 5000 - 40 * k, "go backwards near"),
        (lambda k: 40 * (k ^ 1), "The timestamps of the first frames go backwards"),
    ],
)
def test_times_that_make_no_sense_are_refused(tmp_path: Path, pts: Any, words: str) -> None:
    problem = refused(of_times(tmp_path, pts, 120))
    assert (problem.code, problem.file) == ("video_times", "times.mkv")
    assert words in problem.message


@pytest.mark.parametrize("start", [0, 24])
def test_times_that_go_back_later_are_refused_when_they_are_seen(tmp_path: Path, start: int) -> None:
    video = probed(of_times(tmp_path, lambda k: 40 * (k ^ 1 if k in (30, 31) else k)))
    assert refused_later(video, start).code == "video_times"


def test_frames_after_last_time_that_go_back_are_seen(tmp_path: Path) -> None:
    video = probed(of_times(tmp_path, lambda k: 40 * k if k < NUM_FRAMES - 1 else 40 * (NUM_FRAMES - 4) + 1))
    assert refused_later(video, NUM_FRAMES - 8).code == "video_times"


def test_hidden_frames_of_vp8_are_no_frames(tmp_path: Path) -> None:
    """Video with hidden reference frames in packets with separate times."""

    def hide(number: int, packet: "av.Packet[Any]") -> "Iterable[av.Packet[Any]]":
        if number % 10 != 5:
            return [packet]
        content = bytearray(bytes(packet))
        content[0] &= ~0x10
        hidden = av.Packet(bytes(content))
        hidden.pts, hidden.dts, hidden.time_base = packet.pts, packet.dts, packet.time_base
        return [hidden]

    good = write_video(tmp_path / "a.webm", 40, codec="libvpx", options={"g": "10", "deadline": "realtime"})
    video, damaged = probed(rewrite_packets(good, tmp_path / "hidden.webm", hide)), list[int]()
    assert video.num_frames == 36
    assert len(list(decode(video, 0, 36, damaged.append))) == 36
    assert damaged == []
