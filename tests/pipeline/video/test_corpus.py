"""Videos of many formats: any range of frames is the same slice of the whole, each picture is at its time."""

import random
from collections.abc import Iterator
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


def probed(path: Path) -> VideoInfo:
    found = probe(path)
    assert isinstance(found, VideoInfo), found
    return found


@pytest.fixture(params=CLIPS)
def clip(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[CorpusClip, VideoInfo]:
    return CLIPS[request.param], probed(write_clip(tmp_path, request.param))


def frames(video: VideoInfo, start: int, stop: int) -> Iterator[tuple[int, np.ndarray]]:
    def damaged(number: int) -> None:
        raise AssertionError(f"frame {number} is said to be damaged")

    return decode(video, start, stop, damaged)


def straight(video: VideoInfo) -> list[tuple[float, np.ndarray]]:
    """Times and turned pictures of a sequential decode by PyAV alone."""
    with av.open(str(video.path)) as container:
        found = [(frame.time, frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]
    return [(time_s - found[0][0], np.rot90(image, video.rotation_deg // 90)) for time_s, image in found]


def test_ranges_are_slices_of_the_whole_at_the_right_times(clip: tuple[CorpusClip, VideoInfo]) -> None:
    about, video = clip
    whole = [(number, image_rgb.copy()) for number, image_rgb in frames(video, 0, video.num_frames)]
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
    rng = random.Random(about.codec + about.pix_fmt)  # noqa: S311 - the same each time
    t0, t1 = sorted(rng.uniform(-0.1, video.time_s[-1] + 0.1) for _ in range(2))
    start, stop = (int(np.searchsorted(video.time_s, one)) for one in (t0, t1))
    same(frames(video, start, stop), whole[start:stop])
    same(frames(video, video.num_frames - 1, video.num_frames), whole[-1:])


def same(found: Iterator[tuple[int, np.ndarray]], expected: list[tuple[int, np.ndarray]]) -> None:
    numbers = []
    for (number, image_rgb), (wanted, image) in zip(found, expected, strict=True):
        assert number == wanted
        np.testing.assert_array_equal(image_rgb, image)
        numbers.append(number)
    assert numbers == [number for number, _ in expected]


def test_every_single_frame_and_every_start(clip: tuple[CorpusClip, VideoInfo]) -> None:
    _, video = clip
    whole = [(number, image_rgb.copy()) for number, image_rgb in frames(video, 0, video.num_frames)]
    for start in range(video.num_frames):
        same(frames(video, start, start + 1), whole[start : start + 1])
        same(frames(video, start, min(start + 7, video.num_frames)), whole[start : start + 7])
