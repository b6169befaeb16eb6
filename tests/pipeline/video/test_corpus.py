"""Videos of many formats: any range of frames is the same slice of the whole, each picture is at its time."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.video.corpus import CLIPS, CorpusClip, level, write_clip

# Lossy coding and conversions between colours move a level by less than the step between two pictures.
MAX_DIFFERENCE = 2.4
MAX_ROUNDING = 0.5
# Frames of the ranges from many starts, and starts that are drawn by lot.
RANGE_FRAMES, NUM_DRAWN = 7, 6

Picture = tuple[int, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class DecodedClip:
    """A clip of the corpus, as it was probed, with all of its pictures."""

    about: CorpusClip
    video: VideoInfo
    whole: list[Picture]


def probed(path: Path) -> VideoInfo:
    found = probe(path)
    assert isinstance(found, VideoInfo), found
    return found


@pytest.fixture(scope="module", params=CLIPS)
def clip(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> DecodedClip:
    video = probed(write_clip(tmp_path_factory.mktemp("clip"), request.param))
    whole = [(number, image_rgb.copy()) for number, image_rgb in frames(video, 0, video.num_frames)]
    return DecodedClip(CLIPS[request.param], video, whole)


def frames(video: VideoInfo, start: int, stop: int) -> Iterator[Picture]:
    def damaged(number: int) -> None:
        raise AssertionError(f"frame {number} is said to be damaged")

    return decode(video, start, stop, damaged)


def straight(video: VideoInfo) -> list[tuple[float, np.ndarray]]:
    """Times and turned pictures of a sequential decode by PyAV alone."""
    with av.open(str(video.path)) as container:
        found = [(frame.time, frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]
    return [(time_s - found[0][0], np.rot90(image, video.rotation_deg // 90)) for time_s, image in found]


def test_ranges_are_slices_of_whole_at_right_times(clip: DecodedClip) -> None:
    about, video, whole = clip.about, clip.video, clip.whole
    assert [number for number, _ in whole] == list(range(len(about.pictures)))

    # Properties as shown.
    assert (video.size_px, video.rotation_deg) == (about.expected_px, about.rotation_deg)
    assert {image_rgb.shape for _, image_rgb in whole} == {(video.size_px[1], video.size_px[0], 3)}
    said = {"pixel_aspect": about.pixel_aspect, "interlaced_video": about.is_interlaced, "frames_dropped": about.gaps}
    assert {warning.code for warning in video.warnings} == {code for code, is_so in said.items() if is_so}

    # Times as recorded. Matroska and MP4 with rounded stamps have ticks of a millisecond.
    np.testing.assert_allclose(video.time_s, about.time_s, atol=0.6e-3)
    if about.stamps is None:
        assert video.frame_rate_hz == float(about.rate_hz)

    # The picture of each frame is the one that was drawn for it.
    for (_, image_rgb), number in zip(whole, about.pictures, strict=True):
        upright = np.rot90(image_rgb, -video.rotation_deg // 90)
        half = upright[4:-4, 4 : upright.shape[1] // 2 - 8]
        assert abs(float(half.mean()) - level(number)) < MAX_DIFFERENCE

    # A sequential decode by PyAV alone; conversions of 10 bits, 4:2:2 and fields differ in the rounding of colours.
    expected = straight(video)
    np.testing.assert_allclose([time_s for time_s, _ in expected], video.time_s, atol=1e-9)
    if not about.pixel_aspect:
        for (_, image_rgb), (_, image) in zip(whole, expected, strict=True):
            assert np.abs(image_rgb.astype(int) - image).mean() < MAX_ROUNDING

    # Ranges between times, as stages ask for them.
    rng = rng_of(about)
    t0, t1 = sorted(rng.uniform(-0.1, video.time_s[-1] + 0.1) for _ in range(2))
    start, stop = (int(np.searchsorted(video.time_s, one)) for one in (t0, t1))
    same(frames(video, start, stop), whole[start:stop])
    same(frames(video, video.num_frames - 1, video.num_frames), whole[-1:])


def rng_of(about: CorpusClip) -> random.Random:
    """Random numbers that are the same each time."""
    return random.Random(about.codec + about.pix_fmt)  # noqa: S311


def same(found: Iterator[Picture], expected: list[Picture]) -> None:
    numbers = []
    for (number, image_rgb), (wanted, image) in zip(found, expected, strict=True):
        assert number == wanted
        np.testing.assert_array_equal(image_rgb, image)
        numbers.append(number)
    assert numbers == [number for number, _ in expected]


def starts_of(clip: DecodedClip) -> list[int]:
    """Starts of ranges around the keyframes and at both ends, and some between them.

    Where each frame is a keyframe, all starts are alike: those at the ends and the drawn ones stand for them.
    """
    count, rng = clip.video.num_frames, rng_of(clip.about)
    keyframes = np.searchsorted(clip.video.pts, clip.video.keyframe_pts)
    around = (
        {int(keyframe) + step for keyframe in keyframes for step in (-1, 0, 1)} if len(keyframes) < count else set()
    )
    starts = around | {0, 1, count - RANGE_FRAMES, count - 1} | set(rng.sample(range(count), NUM_DRAWN))
    return sorted(start for start in starts if 0 <= start < count)


def test_every_single_frame_and_starts_near_keyframes(clip: DecodedClip) -> None:
    video, whole = clip.video, clip.whole
    for number in range(video.num_frames):
        same(frames(video, number, number + 1), whole[number : number + 1])
    for start in starts_of(clip):
        same(frames(video, start, min(start + RANGE_FRAMES, video.num_frames)), whole[start : start + RANGE_FRAMES])
