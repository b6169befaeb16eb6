"""Decode images of a sequence; called in child processes only."""

from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import av
from av.error import FFmpegError
from av.video.frame import VideoFrame

from pipeline.core.runtime.zips import ArchiveError
from pipeline.video.container import MAX_PIXELS
from pipeline.video.images.files import open_images

# Decoders by the first bytes of a file. The names of files do not count.
_DECODERS = {b"\xff\xd8\xff": "mjpeg", b"\x89PNG\r\n\x1a\n": "png", b"BM": "bmp", b"II*\0": "tiff", b"MM\0*": "tiff"}


def decode_images(path: Path, is_wanted: Callable[[int], bool]) -> Iterator[VideoFrame]:
    """Decode images in order, with the numbers of their frames as timestamps.

    Images that can't be decoded are skipped, and their frames are missing. ``is_wanted`` tells whether the image of a
    frame is to be decoded, by its number. Raises ``UnusableError``, see ``open_images``.
    """
    with open_images(path) as images:
        for frame in images.frames:
            if is_wanted(frame):
                with suppress(ArchiveError, OSError):
                    if (image := decode_image(images.read(frame))) is not None:
                        image.pts, image.time_base = frame, Fraction(1)
                        yield image


def wanted_images(first: int, last: int, only: Collection[int] | None) -> Callable[[int], bool]:
    """Predicate of the frames of a range, or of some of them."""
    chosen = None if only is None else frozenset(only)
    return lambda frame: first <= frame <= last and (chosen is None or frame in chosen)


def decode_image(content: bytes) -> VideoFrame | None:
    """Decode an image; ``None`` if it is damaged or of another format."""
    name = next((decoder for start, decoder in _DECODERS.items() if content.startswith(start)), None)
    if name is None:
        return None
    decoder = av.CodecContext.create(name, "r")
    if not isinstance(decoder, av.VideoCodecContext):
        return None
    decoder.thread_count = 1
    decoder.options = {"max_pixels": str(MAX_PIXELS)}
    try:
        frames = [*decoder.decode(av.Packet(content)), *decoder.decode(None)]
    except MemoryError:
        raise
    except (FFmpegError, ValueError, EOFError):
        return None
    return frames[0] if frames else None
