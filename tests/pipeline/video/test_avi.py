"""AVI files: places of dropped frames, times of H.264, and files that are cut off."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.core.errors import Problem
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from pipeline.video.signatures import is_cut_avi
from tests.pipeline.media import write_video

CODECS = ("mjpeg", "mpeg4", "libx264", "libvpx")
SIZE_PX = (64, 48)


def write_avi(path: Path, codec: str, kept: Sequence[int], places_a_frame: int = 1) -> Path:
    """Encode the pictures of some places of a recording of 25 Hz; a picture's grey level is its place."""
    options = {"libx264": {"bf": "0", "crf": "10", "g": "12"}, "libvpx": {"deadline": "realtime"}}.get(codec, {})
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = SIZE_PX
        stream.pix_fmt, stream.bit_rate = "yuvj420p" if codec == "mjpeg" else "yuv420p", 3_000_000
        stream.codec_context.time_base = Fraction(1, 25 * places_a_frame)
        for place in kept:
            image = np.full((*SIZE_PX[::-1], 3), grey(place), np.uint8)
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = place, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def grey(place: int) -> int:
    return 20 + 3 * place


def probed(path: Path) -> VideoInfo:
    video = probe(path)
    assert isinstance(video, VideoInfo), video
    return video


DROPS = {
    "five": [place for place in range(60) if not 22 <= place < 27],
    "every third": [place for place in range(60) if place % 3 != 2],
    "second and last but one": [place for place in range(60) if place not in {1, 58}],
}


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("drops", DROPS)
def test_dropped_frames_of_avi_keep_their_places(tmp_path: Path, codec: str, drops: str) -> None:
    kept = DROPS[drops]
    video = probed(write_avi(tmp_path / "a.avi", codec, kept))
    np.testing.assert_allclose(video.time_s, np.array(kept) / 25, atol=1e-9)
    pictures = [int(image.mean()) for _, image in decode(video, 0, len(kept))]
    np.testing.assert_allclose(pictures, [grey(place) for place in kept], atol=4)
    (number, image), *rest = decode(video, 30, 31)
    assert (number, rest) == (30, [])
    assert abs(image.mean() - grey(kept[30])) < 4
    assert video.warnings


def test_h264_with_two_places_frame_has_times_of_its_pictures(tmp_path: Path) -> None:
    """A copy from MP4 has every other place empty, and its header counts all of them."""
    path = write_avi(tmp_path / "a.avi", "libx264", range(60), places_a_frame=2)
    with av.open(str(path)) as container:
        assert container.streams.video[0].frames >= 119
    video = probed(path)
    np.testing.assert_allclose(video.time_s, np.arange(60) / 25, atol=1e-9)
    assert (video.frame_rate_hz, video.warnings) == (25.0, ())


def test_h264_with_b_frames_in_avi_is_refused_with_remedy(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    write_video(path, 40, options={"bf": "3", "x264-params": "b-adapt=0"})
    problem = probe(path)
    assert isinstance(problem, Problem)
    assert problem.code == "video_times"
    assert "B-frames" in str(problem.hint)


def test_header_places_after_last_picture_are_no_fault(tmp_path: Path) -> None:
    path = write_avi(tmp_path / "a.avi", "mjpeg", range(40))
    content = bytearray(path.read_bytes())
    length = content.index(b"strh") + 8 + 32
    assert int.from_bytes(content[length : length + 4], "little") == 40
    content[length : length + 4] = (90).to_bytes(4, "little")
    path.write_bytes(content)
    assert probed(path).num_frames == 40


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("drops", ["five", "every third"])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_avi_that_is_cut_off_is_refused(tmp_path: Path, codec: str, drops: str, share: float) -> None:
    path = write_avi(tmp_path / "a.avi", codec, DROPS[drops])
    content = path.read_bytes()
    begin = content.index(b"movi")
    path.write_bytes(content[: begin + int(share * (content.index(b"idx1") - begin))])
    problem = probe(path)
    assert isinstance(problem, Problem)
    assert problem.code == "video_truncated"


@pytest.mark.parametrize(
    ("lengths", "num_missing", "is_cut"),
    [((40,), 0, False), ((40,), 1, True), ((41, 30), 0, False), ((41, 30), 5, True), ((0,), 0, False)],
)
def test_cut_avi_ends_before_its_last_riff_chunk(
    tmp_path: Path, lengths: Sequence[int], num_missing: int, is_cut: bool
) -> None:
    chunks = [b"RIFF" + length.to_bytes(4, "little") + bytes(length + length % 2) for length in lengths]
    content = b"".join(chunks) or bytes(8)
    path = tmp_path / "a.avi"
    path.write_bytes(content[: len(content) - num_missing])
    assert is_cut_avi(path) == is_cut
    path.write_bytes(content + b"padding of a camera")
    assert not is_cut_avi(path)
