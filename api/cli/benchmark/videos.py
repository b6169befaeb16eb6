"""Long videos made from short videos, for the benchmarks."""

from pathlib import Path

import av

from pipeline.errors import ModelError


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
