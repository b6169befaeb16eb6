"""Files that the system's own ``ffmpeg`` writes and decodes: other encoders, muxers and decoders than PyAV's."""

import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.cases import slow_but

FFMPEG = shutil.which("ffmpeg")
pytestmark = pytest.mark.skipif(FFMPEG is None, reason="ffmpeg is not installed; `make ffmpeg` installs it")

SOURCE = ["-f", "lavfi", "-i", "testsrc2=size=96x64:rate=25:duration=1.6"]
# Arguments after the source, by file; `{cut}` of a file is made from the file before it without encoding again.
FILES: Mapping[str, list[str]] = {
    "vp9-10.webm": ["-c:v", "libvpx-vp9", "-pix_fmt", "yuv420p10le", "-g", "12", "-deadline", "realtime"],
    "telecine.mp4": ["-vf", "tinterlace=interleave_top,setfield=tff", "-c:v", "libx264", "-flags", "+ildct+ilme"],
    "ntsc.mov": ["-r", "30000/1001", "-c:v", "libx264", "-bf", "2", "-g", "15", "-video_track_timescale", "600"],
    "hevc.mkv": ["-c:v", "libx265", "-x265-params", "keyint=10:bframes=3:log-level=0"],
    "theirs.avi": ["-c:v", "mjpeg", "-pix_fmt", "yuvj420p", "-q:v", "2"],
    "passthrough.mp4": ["-vf", "select=not(between(n\\,9\\,12))", "-vsync", "vfr", "-c:v", "libx264", "-g", "10"],
    "cut.mp4": ["-c:v", "libx264", "-bf", "2", "-g", "12"],
}


def run(*words: str) -> bytes:
    assert FFMPEG is not None
    command = [FFMPEG, "-nostdin", "-loglevel", "error", "-y", *words]
    return subprocess.run(command, check=True, capture_output=True).stdout


def write(folder: Path, name: str) -> Path:
    path = folder / name
    run(*SOURCE, *FILES[name], str(path))
    if name.startswith("cut"):
        whole = path.rename(folder / f"whole-{name}")
        run("-ss", "0.6", "-i", str(whole), "-c", "copy", str(path))
    return path


def shown(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times and grey pictures that ffmpeg shows, each frame once."""
    listed = run(
        "-i", str(path), "-vsync", "passthrough", "-copyts", "-f", "framecrc", "-enc_time_base", "1:90000", "-"
    )
    stamps = [int(line.split(b",")[2]) for line in listed.splitlines() if not line.startswith(b"#")]
    raw = run("-i", str(path), "-vsync", "passthrough", "-f", "rawvideo", "-pix_fmt", "gray", "-")
    return (np.array(stamps) - stamps[0]) / 90_000, np.frombuffer(raw, np.uint8).reshape(len(stamps), -1)


@pytest.mark.parametrize("name", slow_but(("telecine.mp4", "ntsc.mov", "passthrough.mp4", "cut.mp4"), FILES))
def test_frames_and_times_are_those_that_ffmpeg_shows(tmp_path: Path, name: str) -> None:
    video = probe(write(tmp_path, name))
    assert isinstance(video, VideoInfo), video
    time_s, pictures = shown(video.path)
    np.testing.assert_allclose(video.time_s, time_s, atol=1e-3)
    found = {number: image_rgb @ np.array([0.299, 0.587, 0.114]) for number, image_rgb in decode(video, 0, 99)}
    assert list(found) == list(range(len(pictures)))
    # Each picture is the nearest to itself: pictures of other times differ by far more than conversions do.
    grey = np.stack([image.ravel() for image in found.values()])
    distance = np.abs(grey[:, None] - pictures[None].astype(float)).mean(axis=2)
    assert (distance.argmin(axis=1) == np.arange(len(pictures))).all()
    middle = len(pictures) // 2
    assert [number for number, _ in decode(video, middle, middle + 3)] == [middle, middle + 1, middle + 2]


def test_properties_that_ffmpeg_states(tmp_path: Path) -> None:
    cut = probe(write(tmp_path, "cut.mp4"))
    assert isinstance(cut, VideoInfo)
    assert cut.num_frames == 25  # an edit list hides the frames between the keyframe and the cut
    fields = probe(write(tmp_path, "telecine.mp4"))
    assert isinstance(fields, VideoInfo)
    assert [warning.code for warning in fields.warnings] == ["interlaced_video"]
    gap = probe(write(tmp_path, "passthrough.mp4"))
    assert isinstance(gap, VideoInfo)
    assert np.diff(gap.time_s).max() == pytest.approx(0.2)
