"""Wrong and damaged lists of keyframes: the same pictures at the same times, or a clear problem."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.core.errors import Problem
from pipeline.video.decode import decode
from pipeline.video.info import seek_points
from pipeline.video.probe import probe
from tests.pipeline.media import write_video
from tests.pipeline.video.test_damage import by_time

NUM_FRAMES = 48

CODECS: dict[str, dict[str, Any]] = {
    "h264": {"codec": "libx264", "options": {"g": "12", "bf": "2"}},
    "hevc": {"codec": "libx265", "options": {"x265-params": "keyint=12:bframes=4:log-level=0"}},
    "mpeg4": {"codec": "mpeg4", "options": {"g": "12", "bf": "2"}},
    "vp9": {"codec": "libvpx-vp9", "options": {"g": "12", "deadline": "realtime"}},
}

# Contents of the box of sync samples: version and flags, number of entries, entries.
BOXES: dict[str, Callable[[bytes], bytes]] = {
    "no entries": lambda box: box[:12] + bytes(4) + box[16:],
    "another box": lambda box: box[:4] + b"free" + box[8:],
    "more entries than bytes": lambda box: box[:12] + b"\xff\xff\xff\xff" + box[16:],
    "zeros": lambda box: box[:16] + bytes(len(box) - 16),
    "beyond the end": lambda box: box[:16] + b"\x7f\xff\xff\xff" * ((len(box) - 16) // 4),
    "all wrong by one": lambda box: (
        box[:16] + (np.frombuffer(box[16:], ">u4") + np.arange(len(box[16:]) // 4).clip(0, 1)).astype(">u4").tobytes()
    ),
}


def same_or_refused(path: Path, good: Path) -> None:
    video = probe(path)
    if isinstance(video, Problem):
        assert video.code in {"video_unreadable", "no_keyframes", "video_truncated", "video_times"}
        assert video.file == path.name
        return
    expected = by_time(good)
    for start, stop in ((0, NUM_FRAMES), (30, 35), (NUM_FRAMES - 4, NUM_FRAMES)):
        damaged: list[int] = []
        numbers = []
        for number, image_rgb in decode(video, start, stop, damaged.append):
            numbers.append(number)
            np.testing.assert_array_equal(image_rgb, expected[int(video.pts[number])])
        assert (numbers, damaged) == (list(range(start, stop)), [])


@pytest.mark.parametrize(
    "codec", [next(iter(CODECS)), *(pytest.param(codec, marks=pytest.mark.slow) for codec in list(CODECS)[1:])]
)
@pytest.mark.parametrize("change", BOXES)
def test_mp4_whose_sync_samples_are_wrong(tmp_path: Path, codec: str, change: str) -> None:
    good = write_video(tmp_path / "good.mp4", NUM_FRAMES, **CODECS[codec])
    content = good.read_bytes()
    start = content.find(b"stss") - 4
    stop = start + int.from_bytes(content[start : start + 4], "big")
    path = tmp_path / "changed.mp4"
    path.write_bytes(content[:start] + BOXES[change](content[start:stop]) + content[stop:])
    same_or_refused(path, good)


@pytest.mark.parametrize(("name", "mark"), [("a.avi", b"idx1"), ("b.mkv", b"\x1c\x53\xbb\x6b")])
@pytest.mark.parametrize("kind", ["cut off", "zeros", "noise"])
def test_damaged_indexes_of_avi_and_mkv(tmp_path: Path, name: str, mark: bytes, kind: str) -> None:
    good = write_video(tmp_path / f"good-{name}", NUM_FRAMES, codec="mpeg4", options={"g": "12"})
    content = good.read_bytes()
    start = content.rfind(mark)
    assert start > len(content) // 2
    rest = content[start:]
    noise = np.random.default_rng(0).integers(0, 256, len(rest), np.uint8).tobytes()
    damaged = {"cut off": b"", "zeros": bytes(len(rest)), "noise": noise}[kind]
    path = tmp_path / name
    path.write_bytes(content[:start] + damaged)
    same_or_refused(path, good)


def test_seeks_go_back_by_twice_distance_each() -> None:
    keyframes = np.arange(0, 1000, 10)
    assert seek_points(keyframes, 5) == []
    assert seek_points(keyframes, 10) == [10]
    assert seek_points(keyframes, 99) == [90, 80, 60, 20]
    assert len(seek_points(np.arange(2_000_000), 1_999_999)) == 21
