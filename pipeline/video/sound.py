"""Sound of videos: the energy of each millisecond from the first frame on.

Each file is opened by ``python -m pipeline.video.sound PATH FIRST_PTS``, a confined program. It writes a JSON line with
the number of values, or with the reason why there are none, and then the values as 32-bit floats.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
from av.audio.frame import AudioFrame
from av.audio.resampler import AudioResampler
from numpy.typing import NDArray

from pipeline.core.runtime import confinement
from pipeline.video.container import DECODE_ERRORS, first_video, open_container, reading_s
from pipeline.video.info import VideoInfo
from pipeline.video.stamps import reordering_delay

CODECS = frozenset({"aac", "mp3", "mp2", "ac3", "eac3", "opus", "vorbis", "flac", "alac"})
"""Codecs whose sound is read, beside uncompressed sound."""

MAX_MS = 4 * 3_600_000
"""Longest sound: four hours; the rest is not read."""

_RATE_HZ = 8000
_SAMPLES = _RATE_HZ // 1000
# Decoding takes far less than a twentieth of the sound's duration.
_BASE_CPU_S, _CPU_S_A_SECOND = 60, 0.05
# Shorter steps in the timestamps are rounding of a container, to a millisecond at most; longer ones are gaps.
_GAP_SAMPLES = 16


def listen_in_child(video: VideoInfo) -> NDArray[np.float32] | str:
    """Energy of each millisecond of a video's sound from its first frame on, or why there is none.

    A file that makes FFmpeg crash, hang or exhaust memory ends only its child, and has no sound then. Raises
    ``ChildError`` if the child fails for a reason other than its file.
    """
    if video.parts:
        energies: list[np.ndarray] = []
        first = 0
        for part in video.parts:
            energy = listen_in_child(part)
            if isinstance(energy, str):
                return energy
            start_ms = round(1000 * float(video.time_s[first]))
            # The sound of a file may be some milliseconds longer or shorter than its pictures.
            have_ms = sum(map(len, energies))
            energies.append(np.zeros(max(0, start_ms - have_ms), np.float32))
            energies.append(energy[max(0, have_ms - start_ms) :])
            first += part.num_frames
        energy = np.concatenate(energies)
        energy.flags.writeable = False
        return energy
    if not len(video.pts) or video.path.is_dir() or video.path.suffix.lower() == ".zip":
        return "Images have no sound."
    max_cpu_s = _BASE_CPU_S + reading_s(video.path) + math.ceil(_CPU_S_A_SECOND * float(video.time_s[-1]))
    arguments = [str(video.path.absolute()), str(int(video.pts[0]))]
    task = f"reading of the sound of {video.path.name}"
    try:
        output = confinement.run_confined(
            "pipeline.video.sound", arguments, confinement.ChildLimits(max_cpu_s), task=task, timeout_s=2.0 * max_cpu_s
        )
    except confinement.BeyondLimitsError:
        return "The sound can't be read within the limits on time and memory."
    header, _, values = output.partition(b"\n")
    answer = json.loads(header)
    return str(answer["reason"]) if "reason" in answer else np.frombuffer(values, np.float32)


def measure_energy(path: Path, first_pts: int) -> NDArray[np.float32] | str:
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
    """Write the energy of a file."""
    path, first_pts = confinement.confined_arguments()
    confinement.tell_ready()
    try:
        found = measure_energy(Path(path), int(first_pts))
    except DECODE_ERRORS:
        found = "The sound can't be read."
    if isinstance(found, str):
        sys.stdout.buffer.write(json.dumps({"reason": found}).encode() + b"\n")
    else:
        sys.stdout.buffer.write(json.dumps({"num_ms": len(found)}).encode() + b"\n")
        sys.stdout.buffer.write(found.tobytes())


if __name__ == "__main__":
    main()
