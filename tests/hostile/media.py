"""Small videos in several containers, valid and damaged."""

import random
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.hostile.mutations import OF_BYTES, spoil
from tests.pipeline.media import write_video

# Headers of boxes, chunks and elements with sizes, counts, times and rates that a reader trusts.
_HEADS = re.compile(
    rb"mvhd|tkhd|mdhd|stts|ctts|stss|stsc|stsz|stco|elst|avih|strh|strf|idx1|LIST|\x2a\xd7\xb1|\x1f\x43\xb6\x75"
)
_WORDS = (b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x80\0\0\0", b"\0\0\0\1", b"\1\0\0\0", b"\0\1\0\0")


def good_videos(folder: Path) -> Mapping[str, bytes]:
    """Contents of small valid videos by file name."""
    write_video(folder / "a.mp4", 12, options={"g": "4"})
    write_video(folder / "b.mkv", 12, options={"g": "4"})
    write_video(folder / "c.avi", 12, codec="mpeg4")
    write_video(folder / "d.avi", 12, codec="mjpeg", pix_fmt="yuvj420p")
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def spoilt_videos(good: Mapping[str, bytes], seed: int, count: int) -> Iterator[tuple[str, bytes]]:
    """Name and content of damaged videos."""
    rng = random.Random(seed)  # noqa: S311 - the same each time
    for _ in range(count):
        name = rng.choice(sorted(good))
        content = good[name]
        if rng.random() < 0.5:
            content = _other_word(content, rng)
        if content is good[name] or rng.random() < 0.3:
            content = spoil(content, rng, OF_BYTES)
        yield name, content


def _other_word(content: bytes, rng: random.Random) -> bytes:
    """Replace a 32-bit number shortly after a header."""
    position = rng.choice(list(_HEADS.finditer(content))).end() + 4 * rng.randrange(14)
    return content[:position] + rng.choice(_WORDS) + content[position + 4 :]
