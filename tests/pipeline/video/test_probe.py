from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from pipeline.core.errors import Problem
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from pipeline.video.probe_process import probe_in_children
from tests.pipeline.media import write_audio, write_video


def refused(path: Path) -> str:
    """Code of the problem of a file."""
    found = probe(path)
    assert isinstance(found, Problem)
    assert found.file == path.name
    assert str(path.parent) not in str(found)
    return found.code


def test_good_file(tmp_path: Path) -> None:
    found = probe(write_video(tmp_path / "a.mp4", 30, options={"g": "10", "bf": "2"}))
    assert isinstance(found, VideoInfo)
    assert (found.num_frames, found.size_px, found.codec, found.rotation_deg) == (30, (64, 48), "h264", 0)
    np.testing.assert_allclose(found.time_s, np.arange(30) / 25.0, atol=1e-6)
    assert found.frame_rate_hz == 25.0
    assert len(found.keyframe_pts) == 3


def test_missing_empty_text_image_and_audio(tmp_path: Path) -> None:
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "text.mp4").write_text("this is a text\n" * 100)
    cv2.imwrite(str(tmp_path / "image.png"), np.zeros((48, 64, 3), np.uint8))
    (tmp_path / "image.png").rename(tmp_path / "image.mp4")
    write_audio(tmp_path / "audio.mp4")
    assert refused(tmp_path / "nowhere.mp4") == "video_missing"
    assert refused(tmp_path / "empty.mp4") == "video_empty"
    assert refused(tmp_path / "text.mp4") == "video_unreadable"
    assert refused(tmp_path / "image.mp4") == "video_unreadable"
    assert refused(tmp_path / "audio.mp4") == "no_video_stream"


def test_playlist_is_not_followed(tmp_path: Path) -> None:
    write_video(tmp_path / "secret.mp4")
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile secret.mp4\n")
    (tmp_path / "hls.mp4").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nsecret.mp4\n#EXT-X-ENDLIST\n")
    assert refused(tmp_path / "list.mp4") == "video_unreadable"
    assert refused(tmp_path / "hls.mp4") == "video_unreadable"


def test_no_index(tmp_path: Path) -> None:
    content = write_video(tmp_path / "whole.mp4").read_bytes()
    path = tmp_path / "no-moov.mp4"
    path.write_bytes(content[: content.find(b"moov") - 4])
    assert refused(path) == "video_unreadable"


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_truncated_with_index_in_front(tmp_path: Path, share: float) -> None:
    path = tmp_path / "front.mp4"
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        noise = np.random.default_rng(0)
        for _ in range(40):
            image = noise.integers(0, 255, (48, 64, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    assert refused(path) == "video_truncated"


def test_zero_frames(tmp_path: Path) -> None:
    path = tmp_path / "none.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.start_encoding()
    assert refused(path) in {"no_frames", "video_unreadable", "no_video_stream"}


def test_unsupported_codec(tmp_path: Path) -> None:
    path = write_video(tmp_path / "old.avi", 5, codec="msmpeg4")
    assert refused(path) == "unsupported_codec"


@pytest.mark.parametrize(("degrees", "turns"), [(90, 1), (180, 2), (-90, 3)])
def test_rotation_is_applied(tmp_path: Path, degrees: int, turns: int) -> None:
    """Portrait video of a phone: the display matrix in the header turns the picture counterclockwise."""
    path = write_video(tmp_path / "phone.mp4", 3)
    content = bytearray(path.read_bytes())
    position = content.find(b"tkhd") + 4 + 4 + 20 + 16
    cosine, sine = round(np.cos(np.deg2rad(degrees))), round(np.sin(np.deg2rad(degrees)))
    # FFmpeg's matrix for a counterclockwise turn: [[c, -s], [s, c]] in 16.16 fixed point.
    for offset, value in ((0, cosine), (4, -sine), (12, sine), (16, cosine)):
        content[position + offset : position + offset + 4] = int(value * 65536).to_bytes(4, "big", signed=True)
    path.write_bytes(content)
    info = probe(path)
    assert isinstance(info, VideoInfo)
    assert info.rotation_deg == degrees % 360
    assert info.size_px == ((48, 64) if turns % 2 else (64, 48))
    with av.open(str(path)) as container:
        stored = next(container.decode(video=0)).to_ndarray(format="rgb24")
    np.testing.assert_array_equal(next(decode(info, 0, 1))[1], np.rot90(stored, turns))


def test_children_report_each_file_on_its_own(tmp_path: Path) -> None:
    good, bad = write_video(tmp_path / "good.mp4"), tmp_path / "bad.mp4"
    bad.write_bytes(b"\0" * 5000)
    found = probe_in_children([good, bad])
    assert isinstance(found[0], VideoInfo)
    assert found[0].num_frames == 30
    assert isinstance(found[1], Problem)
    assert found[1].file == "bad.mp4"
    assert found[0].frame_rate_hz == 25.0
