"""Long takes and videos made from short ones, and peak memory, for the benchmarks."""

import resource
from dataclasses import replace
from pathlib import Path

import av
import numpy as np

from pipeline.core.data.people import Observations, Track3D
from pipeline.core.errors import ModelError


def to_and_fro(values: np.ndarray, num_frames: int) -> np.ndarray:
    """Repeat values forwards and backwards along the first axis, up to a number of frames."""
    period = np.concatenate([values, values[::-1]])
    return np.concatenate([period] * -(-num_frames // len(period)))[:num_frames]


def longer_track(track: Track3D, num_frames: int) -> Track3D:
    """Repeat a track forwards and backwards (``to_and_fro``)."""
    return replace(
        track,
        xyz_m=to_and_fro(track.xyz_m, num_frames),
        score=to_and_fro(track.score, num_frames),
        source=to_and_fro(track.source, num_frames),
        error_px=to_and_fro(track.error_px, num_frames),
        views=to_and_fro(track.views, num_frames),
        uncertainty_m=None if track.uncertainty_m is None else to_and_fro(track.uncertainty_m, num_frames),
    )


def longer_observations(seen: Observations, num_frames: int) -> Observations:
    """Repeat the observations of a track forwards and backwards (``to_and_fro``)."""
    return replace(seen, points_px=to_and_fro(seen.points_px, num_frames), score=to_and_fro(seen.score, num_frames))


def peak_rss_mib() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def loop_video(source: Path, target: Path, loops: int) -> None:
    """Write a video that repeats another ``loops`` times, without encoding it again."""
    with av.open(str(source)) as head, av.open(str(target), "w") as out:
        stream_in = head.streams.video[0]
        stream_out = out.add_stream_from_template(stream_in)
        length = stream_in.duration
        if length is None:
            raise ModelError(f"{source.name} does not say how long it is.")
        for loop in range(loops):
            with av.open(str(source)) as again:
                for packet in again.demux(video=0):
                    if packet.dts is None or packet.pts is None:
                        continue
                    packet.pts += loop * length
                    packet.dts += loop * length
                    packet.stream = stream_out
                    out.mux(packet)
