"""Listen to the sound of a video: ``python -m pipeline.video.sound.listen PATH FIRST_PTS MAX_CPU_S``.

The file is opened in this process alone, which has limits on memory and computing time. After the line ``READY`` it
writes a JSON line with the number of values, or with the reason why there are none, and then the values: the energy of
each millisecond from the first frame of the video on, as 32-bit floats.
"""

import json
import sys
from pathlib import Path

import numpy as np
from av.audio.frame import AudioFrame
from av.audio.resampler import AudioResampler
from numpy.typing import NDArray

from pipeline.video.children import start_child
from pipeline.video.container import DECODE_ERRORS, first_video, open_container
from pipeline.video.stamps import reordering_delay

CODECS = frozenset({"aac", "mp3", "mp2", "ac3", "eac3", "opus", "vorbis", "flac", "alac"})
"""Codecs whose sound is read, beside uncompressed sound."""

MAX_MS = 4 * 3_600_000
"""Longest sound: four hours; the rest is not read."""

_RATE_HZ = 8000
_SAMPLES = _RATE_HZ // 1000
# Shorter steps in the timestamps are rounding of a container, to a millisecond at most; longer ones are gaps.
_GAP_SAMPLES = 16


def energy_of(path: Path, first_pts: int) -> NDArray[np.float32] | str:
    """Energy of each millisecond of the first audio track from the first frame on, or why there is none.

    Differences of samples are squared, so that clicks and claps count for more than hum and wind. ``first_pts`` is the
    timestamp of the first frame of the first video track.
    """
    with open_container(path) as container:
        video = first_video(container)
        streams = [stream for stream in container.streams.audio if stream.codec_context is not None]
        if not streams or video is None or video.time_base is None:
            return "The video has no sound."
        stream = streams[0]
        # The name of the codec, not of one of its decoders such as mp3float.
        name = stream.codec_context.codec.canonical_name
        if name not in CODECS and not name.startswith("pcm_"):
            return f"Sound of the codec {name} is not read."
        stream.codec_context.thread_count = 1
        start_s = float((first_pts - reordering_delay(container, video)) * video.time_base)
        resampler = AudioResampler(format="flt", layout="mono", rate=_RATE_HZ)
        found = _Energy()
        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except DECODE_ERRORS:
                continue
            for frame in frames:
                for piece in resampler.resample(frame) if isinstance(frame, AudioFrame) else ():
                    if not found.add(piece, start_s):
                        return found.values
        return found.values


class _Energy:
    """Energy that grows frame by frame."""

    def __init__(self) -> None:
        self._found = np.zeros(60_000, np.float32)
        self._next: int | None = None  # Sample at which the next piece begins if there is no gap; ``None``: unknown
        self._end = 0
        self._last = 0.0

    @property
    def values(self) -> NDArray[np.float32]:
        return self._found[: self._end]

    def add(self, frame: AudioFrame, start_s: float) -> bool:
        """Add the samples of a frame at its time; returns whether more are wanted."""
        samples = frame.to_ndarray().ravel().astype(np.float64)
        if frame.pts is not None and frame.time_base is not None:
            first = round((float(frame.pts * frame.time_base) - start_s) * _RATE_HZ)
            if self._next is None or abs(first - self._next) > _GAP_SAMPLES:
                self._next = first
        change = np.nan_to_num(np.diff(samples, prepend=self._last), posinf=0.0, neginf=0.0)
        self._last = float(samples[-1]) if len(samples) else self._last
        begin = self._next or 0
        numbers = (begin + np.arange(len(samples))) // _SAMPLES
        self._next = begin + len(samples)
        wanted = (numbers >= 0) & (numbers < MAX_MS)
        if wanted.any():
            self._grow(int(numbers[wanted][-1]) + 1)
            low = int(numbers[wanted][0])
            sums = np.bincount(numbers[wanted] - low, np.minimum(change[wanted] ** 2, 1e6))
            self._found[low : low + len(sums)] += sums.astype(np.float32)
        return not len(numbers) or int(numbers[0]) < MAX_MS

    def _grow(self, end: int) -> None:
        self._end = max(self._end, end)
        if self._end > len(self._found):
            longer = np.zeros(min(MAX_MS, 2 * self._end), np.float32)
            longer[: len(self._found)] = self._found
            self._found = longer


def main() -> None:
    """Run the child process."""
    path, first_pts, max_cpu_s = sys.argv[1:]
    start_child(int(max_cpu_s))
    try:
        found = energy_of(Path(path), int(first_pts))
    except DECODE_ERRORS:
        found = "The sound can't be read."
    if isinstance(found, str):
        sys.stdout.buffer.write(json.dumps({"reason": found}).encode() + b"\n")
    else:
        sys.stdout.buffer.write(json.dumps({"num_ms": len(found)}).encode() + b"\n")
        sys.stdout.buffer.write(found.tobytes())


if __name__ == "__main__":
    main()
