"""Sequences of images: numbered, decoded in ranges, refused where they are no such sequence."""

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.core.errors import InputError, Problem
from pipeline.core.runtime import zips
from pipeline.video.decode import decode
from pipeline.video.images import files
from pipeline.video.images.image_probe import at_rate
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from pipeline.video.probe_process import probe_in_children
from tests.pipeline.media import picture

SIZE_PX = (64, 48)
Write = Callable[[Path, Mapping[str, bytes]], Path]


def image(number: int, ending: str = ".png", size_px: tuple[int, int] = SIZE_PX) -> bytes:
    _, content = cv2.imencode(ending, picture(number, size_px)[..., ::-1])
    return content.tobytes()


def as_folder(path: Path, images: Mapping[str, bytes]) -> Path:
    path.mkdir()
    for name, content in images.items():
        (path / name).write_bytes(content)
    return path


def as_zip(path: Path, images: Mapping[str, bytes]) -> Path:
    archive = path.with_suffix(".zip")
    with zipfile.ZipFile(archive, "w") as entries:
        for name, content in images.items():
            entries.writestr(name, content)
    return archive


def found(path: Path) -> VideoInfo:
    video = probe(path)
    assert isinstance(video, VideoInfo), video
    return video


def refused(path: Path) -> Problem:
    problem = probe(path)
    assert isinstance(problem, Problem)
    assert problem.file == path.name
    return problem


@pytest.mark.parametrize(
    ("write", "ending"),
    [
        *((as_folder, ending) for ending in (".png", ".jpg")),
        *(pytest.param(as_folder, ending, marks=pytest.mark.slow) for ending in (".bmp", ".tiff")),
        (as_zip, ".png"),
        *(pytest.param(as_zip, ending, marks=pytest.mark.slow) for ending in (".jpg", ".bmp", ".tiff")),
    ],
)
def test_ranges_of_images_are_slices_of_whole(tmp_path: Path, write: Write, ending: str) -> None:
    names = {f"IMG_{980 + k}{ending}": image(k, ending) for k in range(30)}  # three digits, then four
    (video,) = probe_in_children([write(tmp_path / "cam", names | {"readme.txt": b"no image"})])
    assert isinstance(video, VideoInfo), video
    assert (video.num_frames, video.size_px) == (30, SIZE_PX)
    video = at_rate(video, 30000 / 1001)
    np.testing.assert_allclose(video.time_s, np.arange(30) * 1001 / 30000, atol=1e-12)
    whole = {number: image_rgb.copy() for number, image_rgb in decode(video, 0, 99)}
    assert list(whole) == list(range(30))
    for number, image_rgb in whole.items():
        expected = cv2.imdecode(np.frombuffer(names[f"IMG_{980 + number}{ending}"], np.uint8), cv2.IMREAD_COLOR)
        assert expected is not None
        assert np.abs(image_rgb.astype(int) - expected[..., ::-1]).mean() < (2 if ending == ".jpg" else 1e-9)
    for start, stop in ((0, 1), (11, 17), (28, 40)):
        for number, image_rgb in decode(video, start, stop):
            np.testing.assert_array_equal(image_rgb, whole[number])
    assert [number for number, _ in decode(video, 0, 30, only=[3, 20])] == [3, 20]


def test_numbers_that_are_left_out_are_dropped_frames(tmp_path: Path) -> None:
    video = at_rate(found(as_zip(tmp_path / "cam", {f"{k:05}.png": image(k) for k in range(7, 40) if k != 20})), 25.0)
    np.testing.assert_allclose(video.time_s[[0, 12, 13]], [0.0, 12 / 25, 14 / 25])
    (warning,) = video.warnings
    assert (warning.code, warning.file) == ("frames_dropped", "cam.zip")
    assert "1 frame is missing, at 0.48 s" in warning.message
    assert [number for number, _ in decode(video, 12, 14)] == [12, 13]


@pytest.mark.parametrize("names", [["a.png", "b.png", "c.png"], ["a1.png", "b1.png", "c1.png"], ["1.png", "5000.png"]])
def test_names_without_numbers_of_frames_are_in_order(tmp_path: Path, names: list[str]) -> None:
    video = found(as_folder(tmp_path / "cam", {name: image(k) for k, name in enumerate(names)}))
    assert video.pts.tolist() == list(range(len(names)))


def test_image_that_can_not_be_decoded_is_damaged_frame(tmp_path: Path) -> None:
    images = {f"{k}.jpg": image(k, ".jpg") for k in range(30)} | {
        "12.jpg": b"no image",
        "15.jpg": b"\xff\xd8\xff\xe0cut",
    }
    video, damaged = found(as_zip(tmp_path / "cam", images)), list[int]()
    assert len(list(decode(video, 0, 30, damaged.append))) == 28
    assert damaged == [12, 15]


def test_no_sequence_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = {f"{k}.png": image(k) for k in range(3)}
    assert refused(as_folder(tmp_path / "empty", {"a.txt": b""})).code == "no_images"
    assert refused(as_zip(tmp_path / "none", {"a.txt": b""})).code == "no_images"
    assert refused(as_zip(tmp_path / "text", {"a.png": b"text"})).code == "no_frames"
    sizes = refused(as_zip(tmp_path / "sizes", good | {"2.png": image(2, size_px=(48, 64))}))
    assert sizes.code == "video_changes_size"
    assert "64 x 48 to 48 x 64" in sizes.message
    folders = refused(as_zip(tmp_path / "folders", {"a/0.png": image(0), "b/1.png": image(1)}))
    assert (folders.code, "several folders" in folders.message) == ("images_archive", True)
    cut = as_zip(tmp_path / "cut", good)
    cut.write_bytes(cut.read_bytes()[:100])
    assert refused(cut).code == "images_archive"
    monkeypatch.setattr(files, "MAX_IMAGE_BYTES", 100)
    assert refused(as_zip(tmp_path / "large", good)).code == "images_archive"
    monkeypatch.setattr(zips, "MAX_ENTRIES", 2)
    assert refused(as_zip(tmp_path / "many", good)).code == "images_archive"


def test_digest_of_folder_is_that_of_its_images(tmp_path: Path) -> None:
    images = {f"{k}.png": image(k) for k in range(3)}
    folder = as_folder(tmp_path / "a", images)
    digest = files.folder_sha256(folder)
    assert files.folder_sha256(as_folder(tmp_path / "b", images | {"notes.txt": b"other"})) == digest
    assert files.folder_sha256(as_folder(tmp_path / "c", images | {"1.png": image(7)})) != digest
    (folder / "2.png").rename(folder / "3.png")
    assert files.folder_sha256(folder) != digest


def test_size_that_changes_later_is_refused_when_it_is_seen(tmp_path: Path) -> None:
    images = {f"{k}.png": image(k, size_px=(80, 48) if k == 20 else SIZE_PX) for k in range(30)}
    video = found(as_zip(tmp_path / "cam", images))
    with pytest.raises(InputError) as raised:
        list(decode(video, 15, 25))
    (problem,) = raised.value.problems
    assert (problem.code, problem.file) == ("video_changes_size", "cam.zip")


def test_image_that_expands_beyond_its_stated_size_is_not_read(tmp_path: Path) -> None:
    """A directory that states a small size of a large entry."""
    path = as_zip(tmp_path / "cam", {f"{k}.png": image(k) for k in range(3)} | {"3.png": bytes(5000)})
    content = bytearray(path.read_bytes())
    entry = content.rindex(b"PK\x01\x02")
    content[entry + 24 : entry + 28] = (10).to_bytes(4, "little")
    path.write_bytes(content)
    damaged: list[int] = []
    assert [number for number, _ in decode(found(path), 0, 9, damaged.append)] == [0, 1, 2]
    assert damaged == [3]
