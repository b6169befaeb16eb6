"""First bytes of video files."""

import random
from pathlib import Path

import pytest

from pipeline.core.errors import Problem
from pipeline.video.container import reading_s
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from pipeline.video.probe_process import probe_in_children
from pipeline.video.signatures import is_container
from tests.pipeline.media import write_video


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        *((f"a.{ending}", "libx264") for ending in ("mp4", "mov", "mkv", "ts", "m2ts")),
        ("a.avi", "mpeg4"),
        ("a.mpg", "mpeg2video"),
        ("a.webm", "libvpx"),
    ],
)
def test_containers_are_known_by_their_first_bytes(tmp_path: Path, name: str, codec: str) -> None:
    path = write_video(tmp_path / name, 12, codec=codec)
    assert is_container(path)
    assert isinstance(probe(path), VideoInfo)


def test_transport_stream_may_begin_in_middle_of_packet(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.ts", 12)
    path.write_bytes(path.read_bytes()[50:])
    assert is_container(path)


@pytest.mark.parametrize(
    "content", [b"", b"G", b"RIFF\0\0\0\0WAVEfmt ", b"#!/bin/sh\n", b"PK\3\4" + b"\0" * 1000, b"\0" * 100_000]
)
def test_all_else_is_no_container(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    assert not is_container(path)


def test_noise_is_told_without_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("pipeline.core.runtime.confinement.subprocess.Popen", forbidden)
    paths = [tmp_path / f"{k}.mp4" for k in range(20)]
    for k, path in enumerate(paths):
        path.write_bytes(random.Random(k).randbytes(5000))  # noqa: S311 - the same each time
    found = probe_in_children(paths)
    assert [(one.code, one.file) for one in found if isinstance(one, Problem)] == [
        ("video_unreadable", path.name) for path in paths
    ]


def test_large_videos_have_more_time(tmp_path: Path) -> None:
    small, large = tmp_path / "small.mp4", tmp_path / "large.mp4"
    for path, num_bytes in ((small, 1000), (large, 16 * 2**30)):
        with path.open("wb") as file:
            file.truncate(num_bytes)
    assert (reading_s(small), reading_s(large)) == (1, 960)
