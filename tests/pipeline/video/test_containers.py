"""Times of pictures and of sound in the containers, codecs and starts that ffmpeg writes.

Each file has a flash and claps at known times after its first picture. The times read must be right within 1 ms, but
for files that state other times. AVI states no delay of its sound's encoder, edit lists have ticks of a millisecond,
and ffmpeg 5.1 writes Opus in Matroska 7 ms early. AAC in fragmented MP4 may have an unknown delay: the files of
ffmpeg are right, and a finding says so of all of them.
"""

import wave
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from scipy.signal import resample_poly

from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from pipeline.video.sound import measure_energy
from tests.cases import slow_but
from tests.pipeline.video.test_ffmpeg_files import FFMPEG, run

pytestmark = pytest.mark.skipif(FFMPEG is None, reason="ffmpeg is not installed; `make ffmpeg` installs it")

NUM_FRAMES, FLASH = 75, 31
SOUND_HZ = 48_000
CLAPS_S = (0.4, 0.83, 1.31, 1.62, 2.27, 2.6)
MAX_ERROR_S = 1e-3
# ffmpeg rounds the start in an edit list down to a millisecond; the measurement here is good to 0.1 ms.
MAX_EDIT_LIST_ERROR_S = 1.1e-3
# Samples that these encoders put before the sound.
ENCODER_DELAY = {"mp2": 481, "ac3": 256}
X265 = ["-c:v", "libx265", "-x265-params"]

VIDEO = {
    "h264": ["-c:v", "libx264", "-bf", "0"],
    "h264-b": ["-c:v", "libx264", "-bf", "3", "-g", "25"],
    "hevc": [*X265, "bframes=0:log-level=0"],
    "hevc-b": [*X265, "bframes=3:log-level=0"],
    "mjpeg": ["-c:v", "mjpeg", "-q:v", "2", "-pix_fmt", "yuvj420p"],
    "mpeg4": ["-c:v", "mpeg4", "-q:v", "2"],
    "mpeg4-b": ["-c:v", "mpeg4", "-q:v", "2", "-bf", "2"],
    "mpeg2-b": ["-c:v", "mpeg2video", "-q:v", "2", "-bf", "2"],
    "vp8": ["-c:v", "libvpx", "-deadline", "realtime", "-b:v", "1M"],
    "vp9": ["-c:v", "libvpx-vp9", "-deadline", "realtime", "-b:v", "1M"],
}
SOUND = {
    "pcm": ["-c:a", "pcm_s16le"],
    "aac": ["-c:a", "aac", "-b:a", "128k"],
    "mp3": ["-c:a", "libmp3lame"],
    "mp2": ["-c:a", "mp2"],
    "ac3": ["-c:a", "ac3"],
    "opus": ["-c:a", "libopus"],
    "vorbis": ["-c:a", "libvorbis"],
    "flac": ["-c:a", "flac"],
    "alac": ["-c:a", "alac"],
}


@dataclass(frozen=True)
class Container:
    """Container of a file, and the codecs that it takes."""

    ending: str
    video: tuple[str, ...]
    sound: tuple[str, ...]
    options: list[str] = field(default_factory=list)
    has_starts: bool = True  # Whether it states a start of the sound apart from the start of the pictures


_MOV_VIDEO = ("h264", "h264-b", "hevc", "hevc-b", "mjpeg", "mpeg4", "mpeg4-b")
CONTAINERS = {
    "mov": Container("mov", _MOV_VIDEO, ("pcm", "aac", "alac", "mp3")),
    "mp4": Container("mp4", (*_MOV_VIDEO, "vp9"), ("aac", "mp3", "opus", "alac", "ac3")),
    "mp4-without-edit-list": Container("mp4", ("h264-b",), ("alac",), ["-use_editlist", "0"]),
    "mp4-negative-offsets": Container("mp4", ("h264-b",), ("aac", "alac"), ["-movflags", "negative_cts_offsets"]),
    "mp4-fragments": Container(
        "mp4", ("h264", "h264-b", "hevc-b"), ("aac", "mp3", "opus", "alac"), ["-movflags", "frag_keyframe+empty_moov"]
    ),
    "mp4-fragments-late-header": Container(
        "mp4", ("h264", "h264-b"), ("aac", "alac"), ["-movflags", "frag_keyframe+empty_moov+delay_moov"]
    ),
    "mkv": Container("mkv", (*VIDEO,), ("pcm", "aac", "mp3", "mp2", "ac3", "vorbis", "flac")),
    "webm": Container("webm", ("vp8", "vp9"), ("vorbis",)),
    "ts": Container("ts", ("h264", "h264-b", "hevc-b", "mpeg2-b"), ("aac", "mp3", "mp2", "ac3", "opus")),
    "avi": Container(
        "avi", ("h264", "mjpeg", "mpeg4", "mpeg4-b", "mpeg2-b", "vp8"), ("pcm", "mp2", "ac3"), has_starts=False
    ),
}
# Starts of the sound after the first picture, in ms.
STARTS_MS = (0, 3, 7, 12, 50, -3, -7, -12, -50)
CASES = [
    (name, video, sound, start_ms)
    for name, container in CONTAINERS.items()
    for video in container.video
    for sound in container.sound
    for start_ms in (STARTS_MS if container.has_starts else (0,))
    # Each sound at each start with one codec of the pictures; each pair of codecs at the start 0.
    if start_ms == 0 or video == container.video[0] or (video == "h264-b" and sound == container.sound[0])
]

QUICK = [("mov", "h264", "pcm", 7), ("mp4-fragments", "h264", "aac", 0), ("avi", "mpeg4-b", "pcm", 0)]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Lossless video of 25 Hz that is dark but for one white picture."""
    path = tmp_path_factory.mktemp("pictures") / "pictures.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(NUM_FRAMES):
            image = np.full((48, 64, 3), 235 if number == FLASH else 30 + number % 5, np.uint8)
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def sound(start_s: float) -> np.ndarray:
    """Samples of claps at their times after the first picture, from a time on."""
    rng = np.random.default_rng(0)
    samples = rng.normal(0.0, 1e-3, 5 * SOUND_HZ)
    for clap_s in CLAPS_S:
        first = round((clap_s + 1.0) * SOUND_HZ)
        samples[first : first + 1200] += rng.normal(0.0, 0.2, 1200) * np.exp(-np.arange(1200) / 200)
    return samples[round((start_s + 1.0) * SOUND_HZ) : 4 * SOUND_HZ]


def write(folder: Path, pictures: Path, case: tuple[str, str, str, int]) -> Path:
    name, video, codec, start_ms = case
    container = CONTAINERS[name]
    with wave.open(str(folder / "sound.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(SOUND_HZ)
        file.writeframes((sound(start_ms / 1000) * 32767).astype("<i2").tobytes())
    # Of sound that starts earlier the pictures are moved: ffmpeg cuts off sound of negative times.
    inputs = ["-itsoffset", str(max(0, -start_ms) / 1000), "-i", str(pictures)]
    inputs += ["-itsoffset", str(max(0, start_ms) / 1000), "-i", str(folder / "sound.wav")]
    path = folder / f"a.{container.ending}"
    clock = ["-vsync", "passthrough", "-enc_time_base:v", "1:1000"] if start_ms < 0 else []
    run(*inputs, "-map", "0:v", "-map", "1:a", *clock, *VIDEO[video], *SOUND[codec], *container.options, str(path))
    return path


def lag_s(path: Path, first_pts: int) -> float:
    """Time by which the claps of a file are late."""
    energy = measure_energy(path, first_pts)
    assert not isinstance(energy, str), energy
    change = np.diff(resample_poly(sound(0.0), 1, 6), prepend=0.0)
    expected = np.sqrt((change**2)[: len(change) // 8 * 8].reshape(-1, 8).sum(1))
    size = max(len(energy), len(expected)) + 400
    both = np.zeros((2, size))
    both[0, : len(energy)], both[1, : len(expected)] = np.sqrt(energy), expected
    together = np.fft.irfft(np.fft.rfft(both[0]) * np.conj(np.fft.rfft(both[1])), size)
    lags = np.r_[np.arange(-200, 201)]
    values = together[lags]
    best = int(np.argmax(values))
    left, top, right = values[best - 1 : best + 2]
    return float(lags[best] + 0.5 * (left - right) / (left - 2 * top + right)) / 1000


def probed(path: Path) -> VideoInfo:
    video = probe(path)
    assert isinstance(video, VideoInfo), video
    return video


@pytest.mark.parametrize(("name", "codec", "sound_codec", "start_ms"), slow_but(QUICK, CASES))
def test_pictures_and_claps_are_at_their_times(
    tmp_path: Path, pictures: Path, name: str, codec: str, sound_codec: str, start_ms: int
) -> None:
    video = probed(write(tmp_path, pictures, (name, codec, sound_codec, start_ms)))
    assert video.num_frames == NUM_FRAMES
    np.testing.assert_allclose(video.time_s, np.arange(NUM_FRAMES) / 25, atol=MAX_ERROR_S)
    bright = [number for number, image in decode(video, 0, NUM_FRAMES) if image.mean() > 130]
    assert bright == [FLASH]
    late_s = ENCODER_DELAY.get(sound_codec, 0) / SOUND_HZ if name == "avi" else 0.0
    max_error_s = MAX_EDIT_LIST_ERROR_S if CONTAINERS[name].ending in {"mp4", "mov"} else MAX_ERROR_S
    assert lag_s(video.path, int(video.pts[0])) == pytest.approx(late_s, abs=max_error_s)
    # Sound that begins after the delay in fragments: whether an edit list states it is not seen.
    is_unknown = sound_codec == "aac" and (name, start_ms > 40) in {
        *(("mp4-fragments", is_late) for is_late in (False, True)),
        ("mp4-fragments-late-header", True),
    }
    assert ("sound_delay_unknown" in [warning.code for warning in video.warnings]) == is_unknown
