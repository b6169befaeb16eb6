"""Display matrices of videos and EXIF orientations of images: pictures are shown like players show them."""

from collections.abc import Callable, Mapping
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from pipeline.core.errors import Problem
from pipeline.video.decode import decode
from pipeline.video.images.image_probe import at_rate
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from pipeline.video.rotation import Rotator

SIZE_PX = (64, 48)
# By number of the EXIF orientation (TIFF 6.0, tag 274): the stored picture as shown.
SHOWN: Mapping[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda stored: stored,
    2: np.fliplr,
    3: lambda stored: np.rot90(stored, 2),
    4: np.flipud,
    5: lambda stored: np.transpose(stored, (1, 0, 2)),
    6: lambda stored: np.rot90(stored, -1),
    7: lambda stored: np.transpose(stored[::-1, ::-1], (1, 0, 2)),
    8: np.rot90,
}
MIRRORED = {2, 4, 5, 7}
# Display matrix (a, b, c, d) that shows a stored picture as an EXIF orientation does: x' = a x + c y, y' = b x + d y.
MATRICES = {
    1: (1, 0, 0, 1),
    2: (-1, 0, 0, 1),
    3: (-1, 0, 0, -1),
    4: (1, 0, 0, -1),
    5: (0, 1, 1, 0),
    6: (0, 1, -1, 0),
    7: (0, -1, -1, 0),
    8: (0, -1, 1, 0),
}


def stored_picture() -> np.ndarray:
    """Picture without any symmetry."""
    width, height = SIZE_PX
    image = np.full((height, width, 3), 40, np.uint8)
    image[: height // 2, : width // 4] = 230
    image[: height // 4] = np.maximum(image[: height // 4], 140)
    return image


def write_video(path: Path, orientation: int) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "10"})
        assert isinstance(stream, av.VideoStream)
        (stream.width, stream.height), stream.pix_fmt = SIZE_PX, "yuv420p"
        for number in range(5):
            frame = av.VideoFrame.from_ndarray(stored_picture(), format="rgb24")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    content = bytearray(path.read_bytes())
    matrix = content.find(b"tkhd") + 4 + 4 + 20 + 16
    for offset, value in zip((0, 4, 12, 16), MATRICES[orientation], strict=True):
        content[matrix + offset : matrix + offset + 4] = (value * 65536).to_bytes(4, "big", signed=True)
    path.write_bytes(content)
    return path


def exif(orientation: int) -> bytes:
    """EXIF data with the orientation alone."""
    return b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0" + bytes([orientation]) + bytes(6)


def write_jpegs(folder: Path, orientation: int) -> Path:
    folder.mkdir()
    jpeg = cv2.imencode(".jpg", stored_picture()[..., ::-1])[1].tobytes()
    segment = b"Exif\0\0" + exif(orientation)
    content = jpeg[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2) + segment + jpeg[2:]
    for number in range(5):
        (folder / f"{number:04}.jpg").write_bytes(content)
    return folder


def test_images_of_several_orientations_are_refused(tmp_path: Path) -> None:
    images = write_jpegs(tmp_path / "images", 1)
    (images / "0003.jpg").write_bytes((write_jpegs(tmp_path / "others", 3) / "0003.jpg").read_bytes())
    problem = probe(images)
    assert isinstance(problem, Problem)
    assert (problem.code, problem.file) == ("video_changes_size", "images")
    assert "orientation" in problem.message


def shown(video: VideoInfo) -> np.ndarray:
    frames = decode(video, 2, 3)
    image: np.ndarray = next(frames)[1].astype(float)
    frames.close()
    return image


@pytest.mark.parametrize("orientation", SHOWN)
def test_video_is_shown_by_its_display_matrix(tmp_path: Path, orientation: int) -> None:
    video = probe(write_video(tmp_path / "a.mp4", orientation))
    assert isinstance(video, VideoInfo), video
    expected = SHOWN[orientation](stored_picture())
    assert video.size_px == expected.shape[1::-1]
    assert np.abs(shown(video) - expected).mean() < 4.0
    is_mirrored = orientation in MIRRORED
    assert [(warning.code, warning.file) for warning in video.warnings] == [("shown_mirrored", "a.mp4")] * is_mirrored
    # Browsers turn pictures, but not all of them mirror them: a mirrored video is played by its proxy.
    assert (video.browser_media_type is None) == is_mirrored


@pytest.mark.parametrize("orientation", SHOWN)
def test_images_are_shown_by_their_exif_orientation(tmp_path: Path, orientation: int) -> None:
    images = probe(write_jpegs(tmp_path / "images", orientation))
    assert isinstance(images, VideoInfo), images
    expected = SHOWN[orientation](stored_picture())
    assert images.size_px == expected.shape[1::-1]
    assert np.abs(shown(at_rate(images, 25.0)) - expected).mean() < 4.0
    assert [warning.code for warning in images.warnings] == ["shown_mirrored"] * (orientation in MIRRORED)


SIZES = [(480, 640), (1080, 1920), (65, 3), (63, 129), (1, 1)]


@pytest.mark.parametrize("quarters", range(-1, 5))
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("is_view", [False, True])
def test_pixels_are_turned_exactly(size: tuple[int, int], quarters: int, is_view: bool) -> None:
    rotate, rng = Rotator(), np.random.default_rng(size)
    for _ in range(2):
        image = rng.integers(0, 256, (*size, 3), np.uint8)
        image = np.rot90(image) if is_view else image
        np.testing.assert_array_equal(rotate(image, quarters), np.rot90(image, quarters))


def test_memory_is_reused_and_upright_pictures_not_copied() -> None:
    rotate, image = Rotator(), np.zeros((20, 30, 3), np.uint8)
    assert rotate(image, 0) is image
    assert np.shares_memory(rotate(image, 1), rotate(image + 1, 3))
    assert not np.shares_memory(rotate(image, 2), image)
