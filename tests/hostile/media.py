"""Small videos in several containers, and archives of images, valid and damaged."""

import io
import random
import re
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.hostile.mutations import OF_BYTES, spoil
from tests.pipeline.media import write_video
from tests.pipeline.video.images.test_images import image
from tests.pipeline.video.properties.test_container_clocks import NTSC, write

# Headers of boxes, chunks, elements and archives with sizes, counts, times and rates that a reader trusts.
_HEADS = re.compile(
    rb"mvhd|tkhd|mdhd|stts|ctts|stss|stsc|stsz|stco|elst|avih|strh|strf|idx1|LIST|stsd|pasp|tmcd|PK\x01\x02|PK\x03\x04|PK\x05\x06|\x2a\xd7\xb1|\x1f\x43\xb6\x75"
)
_WORDS = (b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x80\0\0\0", b"\0\0\0\1", b"\1\0\0\0", b"\0\1\0\0")


def good_videos(folder: Path) -> Mapping[str, bytes]:
    """Contents of small valid videos by file name."""
    write_video(folder / "a.mp4", 12, options={"g": "4"})
    write_video(folder / "b.mkv", 12, options={"g": "4"})
    write_video(folder / "c.avi", 12, codec="mpeg4")
    write_video(folder / "d.avi", 12, codec="mjpeg", pix_fmt="yuvj420p")
    write_video(folder / "e.webm", 12, codec="libvpx-vp9", options={"g": "4", "deadline": "realtime"})
    write_video(folder / "f.mp4", 12, codec="libx265", options={"x265-params": "keyint=4:bframes=2:log-level=0"})
    write_video(folder / "g.ts", 12, codec="mpeg2video", options={"g": "4", "bf": "2"})
    write_video(folder / "h.mov", 12, codec="prores_ks", pix_fmt="yuv422p10le")
    write(folder / "i.mov", NTSC, timecode="10:00:00;02", creation_time="2024-05-01T10:00:03Z")
    write_video(folder / "j.mkv", 12, codec="libsvtav1", options={"g": "4", "preset": "12"})
    for name, ending in (("k", ".png"), ("l", ".jpg"), ("m", ".tiff"), ("n", ".bmp")):
        (folder / f"{name}.zip").write_bytes(_archive({f"{k:03}{ending}": image(k, ending) for k in range(12)}))
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def spoilt_videos(good: Mapping[str, bytes], seed: int, count: int) -> Iterator[tuple[str, bytes]]:
    """Name and content of damaged videos."""
    rng = random.Random(seed)  # noqa: S311 - the same each time
    for _ in range(count):
        name = rng.choice(sorted(good))
        content = good[name]
        if name.endswith(".zip") and rng.random() < 0.5:
            content = _inside(content, rng)
        elif rng.random() < 0.1:
            content = _spliced(content, good[rng.choice(sorted(good))], rng)
        elif rng.random() < 0.5:
            content = _other_word(content, rng)
        if content is good[name] or rng.random() < 0.3:
            content = spoil(content, rng, OF_BYTES)
        yield name, content


def _archive(files: Mapping[str, bytes]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as entries:
        for name, image_content in files.items():
            entries.writestr(name, image_content)
    return content.getvalue()


def _inside(content: bytes, rng: random.Random) -> bytes:
    """Damage images of an archive that is itself valid, the first one too."""
    with zipfile.ZipFile(io.BytesIO(content)) as entries:
        files = {name: entries.read(name) for name in entries.namelist()}
    for name in {min(files), *rng.sample(sorted(files), 3)} if rng.random() < 0.3 else rng.sample(sorted(files), 2):
        files[name] = spoil(files[name], rng, OF_BYTES)
    return _archive(files)


def _spliced(content: bytes, other: bytes, rng: random.Random) -> bytes:
    """Begin as one file, go on as another."""
    return content[: rng.randrange(len(content))] + other[rng.randrange(len(other)) :]


def _other_word(content: bytes, rng: random.Random) -> bytes:
    """Replace a 32-bit number shortly after a header."""
    headers = list(_HEADS.finditer(content))
    if not headers:
        return content
    position = rng.choice(headers).end() + 4 * rng.randrange(14)
    return content[:position] + rng.choice(_WORDS) + content[position + 4 :]
