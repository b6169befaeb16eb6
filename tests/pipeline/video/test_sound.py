"""Sound of real files: onsets at their times after the first frame, odd files, and hostile ones."""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.capture.synchronization.sound_offsets import find_lag, onset_strength
from pipeline.video.info import VideoInfo
from pipeline.video.joined import join_parts
from pipeline.video.probe_process import probe_in_children
from pipeline.video.sound import _Energy, listen_in_child
from tests.pipeline.media import picture, write_video
from tests.pipeline.video.children import in_children

RATE_HZ = 48_000
CLICKS_S = (0.31, 0.94, 1.22, 1.71, 2.05, 2.86, 3.3, 3.57)


def clicks(duration_s: float, times_s: tuple[float, ...], seed: int = 0) -> np.ndarray:
    """Claps in a little noise: samples of one channel."""
    rng = np.random.default_rng(seed)
    samples = 0.002 * rng.standard_normal(round(duration_s * RATE_HZ))
    for time_s in times_s:
        start = round(time_s * RATE_HZ)
        if 0 <= start < len(samples) - 2400:
            samples[start : start + 2400] += 0.5 * rng.standard_normal(2400) * np.exp(-np.arange(2400) / 400)
    return np.clip(samples, -1.0, 1.0)


def filmed(
    path: Path,
    samples: np.ndarray,
    codec: str = "aac",
    sound_first_s: float = 0.0,
    seconds: float = 4.0,
    muxer: Mapping[str, str] | None = None,
) -> Path:
    """Video with sound; ``sound_first_s`` is the time of its first sample after the first frame."""
    with av.open(str(path), "w", options=dict(muxer or {})) as container:
        video = container.add_stream("libx264", rate=25)
        audio = container.add_stream(codec, rate=RATE_HZ, layout="mono")
        assert isinstance(video, av.VideoStream)
        assert isinstance(audio, av.AudioStream)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        for number in range(round(25 * seconds)):
            container.mux(video.encode(av.VideoFrame.from_ndarray(picture(number, (64, 48)), format="rgb24")))
        container.mux(video.encode())
        for start in range(0, len(samples), 1024):
            block = (samples[start : start + 1024] * 32767).astype(np.int16)[None]
            frame = av.AudioFrame.from_ndarray(block, format="s16", layout="mono")
            frame.sample_rate = RATE_HZ
            frame.pts, frame.time_base = start + round(sound_first_s * RATE_HZ), Fraction(1, RATE_HZ)
            container.mux(audio.encode(frame))
        container.mux(audio.encode())
    return path


def examined(path: Path) -> VideoInfo:
    (video,) = probe_in_children([path])
    assert isinstance(video, VideoInfo)
    return video


def onsets_s(path: Path) -> list[float]:
    energy = listen_in_child(examined(path))
    assert not isinstance(energy, str), energy
    loud = energy > 0.05 * energy.max()
    return [round(k / 1000, 3) for k in np.flatnonzero(loud) if not loud[max(0, k - 100) : k].any()]


@pytest.mark.slow
def test_claps_of_all_parts_are_at_their_times_in_whole(tmp_path: Path) -> None:
    """The sound of the first part ends before its pictures, that of the second after them."""
    lengths_s = (3.8, 4.3, 4.0)
    parts = [
        examined(filmed(tmp_path / f"part{number}.mov", clicks(length_s, CLICKS_S[number:4]), "pcm_s16le"))
        for number, length_s in enumerate(lengths_s)
    ]
    energy = listen_in_child(join_parts(parts))
    assert not isinstance(energy, str), energy
    loud = energy > 0.05 * energy.max()
    found_s = [k / 1000 for k in np.flatnonzero(loud) if not loud[max(0, k - 100) : k].any()]
    expected_s = [4.0 * number + time_s for number in range(3) for time_s in CLICKS_S[number:4]]
    assert found_s == pytest.approx(expected_s, abs=0.002)
    silent = examined(write_video(tmp_path / "silent.mp4", 100))
    assert listen_in_child(join_parts([parts[0], silent])) == "The video has no sound."


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "aac"), ("a.mkv", "pcm_s16le"), ("a.mov", "pcm_s16le")])
def test_claps_are_at_their_times(tmp_path: Path, name: str, codec: str) -> None:
    found = onsets_s(filmed(tmp_path / name, clicks(4.0, CLICKS_S), codec))
    assert found == pytest.approx(CLICKS_S, abs=0.002)


@pytest.mark.parametrize(
    ("name", "first_s"), [("a.mkv", 0.25), ("a.mov", 0.012), ("a.mkv", 0.009), ("a.mov", 0.007), ("a.mov", 0.003)]
)
def test_sound_that_begins_after_first_frame_keeps_its_times(tmp_path: Path, name: str, first_s: float) -> None:
    found = onsets_s(filmed(tmp_path / name, clicks(4.0, CLICKS_S), "pcm_s16le", sound_first_s=first_s))
    assert found == pytest.approx([click_s + first_s for click_s in CLICKS_S], abs=0.001)


@pytest.mark.parametrize(
    ("name", "codec"), [("a.mp4", "libmp3lame"), ("a.mkv", "libmp3lame"), ("a.ts", "mp2"), ("a.mkv", "libopus")]
)
def test_sound_of_compressed_codecs_is_at_its_times(tmp_path: Path, name: str, codec: str) -> None:
    assert onsets_s(filmed(tmp_path / name, clicks(4.0, CLICKS_S), codec)) == pytest.approx(CLICKS_S, abs=0.002)


def test_gaps_of_few_milliseconds_add_up(tmp_path: Path) -> None:
    """Pieces of half a second, each 6 ms after the end of the one before."""
    energy = _Energy()
    for number in range(4):
        samples = np.zeros((1, 4000), np.float32)
        samples[0, 800] = 1.0
        frame = av.AudioFrame.from_ndarray(samples, format="flt", layout="mono")
        frame.sample_rate, frame.pts, frame.time_base = 8000, number * 4048, Fraction(1, 8000)
        assert energy.add(frame, 0.0)
    assert np.flatnonzero(energy.values).tolist() == [100 + 506 * number for number in range(4)]


@pytest.mark.parametrize(
    ("name", "movflags", "codes"),
    [
        ("a.mp4", "faststart", []),
        ("a.mov", "faststart", []),
        ("a.mp4", "frag_keyframe+empty_moov", ["sound_delay_unknown"]),
        ("a.mp4", "frag_keyframe+empty_moov+delay_moov", []),
    ],
)
def test_aac_whose_delay_is_not_stated_is_finding(
    tmp_path: Path, name: str, movflags: str, codes: Sequence[str]
) -> None:
    video = examined(filmed(tmp_path / name, clicks(4.0, CLICKS_S), muxer={"movflags": movflags}))
    assert [warning.code for warning in video.warnings] == codes


@pytest.mark.parametrize("late_s", [0.137, *(pytest.param(late_s, marks=pytest.mark.slow) for late_s in (0.0, 0.6))])
def test_lag_of_two_files(tmp_path: Path, late_s: float) -> None:
    first = filmed(tmp_path / "a.mp4", clicks(4.0, CLICKS_S, 1))
    second = filmed(tmp_path / "b.mp4", clicks(4.0, tuple(one - late_s for one in CLICKS_S), 2))
    strengths = [onset_strength(np.asarray(listen_in_child(examined(path)))) for path in (first, second)]
    assert strengths[0] is not None
    assert strengths[1] is not None
    found = find_lag(strengths[0], strengths[1])
    assert found is not None
    assert found.lag_s == pytest.approx(late_s, abs=0.002)


def test_video_without_sound_says_so(tmp_path: Path) -> None:
    assert listen_in_child(examined(write_video(tmp_path / "a.mp4"))) == "The video has no sound."


def damage(content: bytearray) -> None:
    rng = np.random.default_rng(3)
    for place in rng.integers(2000, len(content) - 2000, 400):
        content[place] ^= 0xFF


@pytest.mark.parametrize("change", [damage, lambda content: content.__delitem__(slice(len(content) // 2, None))])
def test_damaged_files_end_in_sound_or_reason(tmp_path: Path, change: Callable[[bytearray], object]) -> None:
    video = examined(filmed(tmp_path / "a.mkv", clicks(4.0, CLICKS_S), "pcm_s16le"))
    content = bytearray(video.path.read_bytes())
    change(content)
    video.path.write_bytes(content)
    found = listen_in_child(video)
    assert isinstance(found, str) or (np.isfinite(found).all() and len(found) < 3_600_000)


def test_file_that_kills_its_decoder_has_no_sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    video = examined(filmed(tmp_path / "a.mp4", clicks(4.0, CLICKS_S)))
    faults = tmp_path / "faults"
    faults.mkdir()
    is_child = "any('pipeline.video.sound' in one for one in sys.orig_argv)"
    text = f"import os, sys\nif {is_child}: print('ready', flush=True); os.abort()\n"
    in_children(faults, monkeypatch, text)
    assert "within the limits" in str(listen_in_child(video))
