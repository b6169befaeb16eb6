"""Delay that an encoder puts before its sound, and files that do not state it."""

from pathlib import Path

from pipeline.core.errors import Problem
from pipeline.core.problems.findings import SOUND_DELAY_UNKNOWN
from pipeline.video.container import DECODE_ERRORS, open_container

_AAC_SAMPLES = 1024


def unknown_delays(path: Path) -> list[Problem]:
    """Warn of AAC in MP4 or MOV whose encoder delay is not stated; reads the first packet of the first sound track.

    An edit list states the delay, and FFmpeg cuts it off. Fragmented files without one begin with the delay as sound.
    """
    try:
        with open_container(path) as container:
            streams = [stream for stream in container.streams.audio if stream.codec_context is not None]
            if "mp4" not in container.format.name.split(",") or not streams:
                return []
            stream = streams[0]
            first = next(container.demux(stream))
            # A sound that begins later, with its delay before it, is stated by an edit list too.
            is_stated = first.pts is None or first.pts < 0 or (first.pts > 0 and stream.frames > 0)
            if stream.codec_context.codec.canonical_name != "aac" or is_stated:
                return []
            delay_ms = 1000 * _AAC_SAMPLES / stream.codec_context.sample_rate
    except (*DECODE_ERRORS, StopIteration, ZeroDivisionError):
        return []
    return [
        Problem(
            SOUND_DELAY_UNKNOWN,
            f"The file does not state the delay of its AAC sound: the sound may be off by {delay_ms:.0f} ms or more.",
            hint="This concerns synchronisation by sound alone. An MP4 file that is not fragmented states the delay.",
        )
    ]
