import shutil
from fractions import Fraction
from pathlib import Path

import av
import pytest

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages import samples
from pipeline.core.runtime.packages.storage import file_sha256, home

CAMERAS = ["cam01", "cam02", "cam03", "cam04"]


@pytest.fixture
def fresh_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Storage folder with the downloaded package of the sample capture, and nothing else."""
    samples.install()
    downloaded = home() / "downloads" / "pose2sim-0.10.49-py3-none-any.whl"
    (tmp_path / "downloads").mkdir()
    if downloaded.is_file():
        (tmp_path / "downloads" / downloaded.name).symlink_to(downloaded)
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    return tmp_path


def test_sample_has_four_videos_of_100_frames(fresh_home: Path) -> None:
    assert samples.locate() is None
    sample = samples.install()
    assert sample.path.is_relative_to(fresh_home)
    assert list(sample.videos) == CAMERAS
    for path in sample.videos.values():
        with av.open(path) as container:
            stream = container.streams.video[0]
            assert (stream.width, stream.height, stream.frames) == (1088, 1920, 100)
            assert stream.average_rate == Fraction(60)
    assert b'serial="cam04"' in sample.calibration.read_bytes()


def test_authors_are_named_beside_it() -> None:
    sample = samples.install()
    assert "Redistribution and use" in (sample.path / "LICENSE.txt").read_text()
    assert "perfanalytics" in (sample.path / "ATTRIBUTION.txt").read_text()
    assert sample.licence == "BSD-3-Clause"
    assert "BSD-3-Clause" in sample.attribution


def test_notes_about_sample_explain_its_warnings() -> None:
    digests = [file_sha256(path) for path in samples.install().videos.values()]
    assert set(samples.notes_about(digests)) == {"few_views", "camera_disagrees"}
    assert samples.notes_about(digests[:3]) == samples.notes_about([]) == {}


def test_damaged_sample_is_installed_again(fresh_home: Path) -> None:
    video = samples.install().videos["cam02"]
    whole = video.read_bytes()
    video.write_bytes(whole[:1000])
    assert samples.locate() is None
    samples.install()
    assert video.read_bytes() == whole


def test_package_with_another_video_is_refused(fresh_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    member = samples._Member("Pose2Sim/Demo_MultiPerson/videos/cam01.mp4", "0" * 64)
    monkeypatch.setattr(samples, "_MEMBERS", {"videos/cam01.mp4": member})
    with pytest.raises(ModelError, match=r"cam01\.mp4 in the package has a wrong checksum"):
        samples.install()
    assert not (fresh_home / "samples" / "pose2sim-multi-person" / "videos" / "cam01.mp4").exists()


def test_moved_storage_is_found(fresh_home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    samples.install()
    shutil.copytree(fresh_home / "samples", tmp_path / "moved" / "samples")
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path / "moved"))
    located = samples.locate()
    assert located is not None
    assert located.path.is_relative_to(tmp_path / "moved")
