"""Pictures of real video files: what is decoded of them, and faults that are found."""

import io
from pathlib import Path
from typing import NoReturn

import av
import cv2
import numpy as np
import pytest

from pipeline.capture.pictures import sample_pictures
from pipeline.capture.pictures.sample_pictures import NUM_PICTURES, frames_to_look_at, look_at_pictures
from pipeline.capture.preflight_record import Recording
from pipeline.capture.session import open_session
from pipeline.core.errors import ChildError
from pipeline.core.findings import Finding
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.cases import slow_but
from tests.pipeline.capture.pictures.rooms import walk
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.media import write_pictures, write_video

SIZE_PX = (320, 180)
NAMES = ["left", "right"]
OTHER = {"crf": "34", "g": "7", "bf": "0"}


@pytest.fixture(scope="module")
def walks() -> dict[str, list[np.ndarray]]:
    return {name: walk(seed, 60) for seed, name in enumerate(NAMES)}


def session_of(folder: Path, videos: dict[str, list[np.ndarray]], recordings: tuple[Recording, ...] = ()) -> list[Path]:
    folder.mkdir()
    return [
        write_pictures(folder / f"{name}.mp4", images, OTHER if k else None)
        for k, (name, images) in enumerate(videos.items())
    ]


def found(folder: Path, videos: dict[str, list[np.ndarray]]) -> list[Finding]:
    paths = session_of(folder / "videos", videos)
    session = open_session(paths, calibration(folder / "c.json", NAMES, SIZE_PX))
    return list(look_at_pictures(session).findings)


def test_good_videos_have_pictures_and_no_findings(tmp_path: Path, walks: dict[str, list[np.ndarray]]) -> None:
    paths = session_of(tmp_path / "videos", walks)
    rig = calibration(tmp_path / "c.json", NAMES, SIZE_PX)
    looked = look_at_pictures(open_session(paths, rig, [Recording("right", offset_s=0.5)]))
    assert looked.findings == ()
    left, right = looked.thumbnails
    assert len(left) == len(right) == NUM_PICTURES
    assert [one.time_s for one in left] == [pytest.approx(k / 25) for k in (3, 11, 18, 26, 33, 41, 48, 56)]
    assert right[0].time_s >= 0.5
    image = cv2.imdecode(np.frombuffer(left[2].content, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert np.abs(image[..., ::-1].astype(int) - walks["left"][18]).mean() < 6.0


@pytest.mark.parametrize(
    "code", slow_but(["picture_blurred"], ["picture_dark", "picture_blurred", "picture_frozen", "same_video"])
)
def test_fault_is_found_and_named(tmp_path: Path, walks: dict[str, list[np.ndarray]], code: str) -> None:
    right = {
        "picture_dark": [image // 8 for image in walks["right"]],
        "picture_blurred": [cv2.GaussianBlur(image, (0, 0), 4.0) for image in walks["right"]],
        "picture_frozen": walks["right"][:1] * 60,
        "same_video": walks["left"],
    }[code]
    (finding,) = found(tmp_path, {"left": walks["left"], "right": right})
    assert (finding.code, finding.camera) == (code, "right")
    assert set(finding.evidence["pictures"]) <= set(range(NUM_PICTURES))


def info(path: Path, keyframe_distance: int, num_frames: int = 100) -> VideoInfo:
    options = {"g": str(keyframe_distance), "keyint_min": str(keyframe_distance), "sc_threshold": "0", "bf": "0"}
    read = probe(write_video(path, num_frames, options=options))
    assert isinstance(read, VideoInfo)
    return read


def test_keyframes_are_looked_at_where_there_are_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert frames_to_look_at(info(tmp_path / "many.mp4", 5)) == [5, 20, 30, 45, 55, 70, 80, 95]
    few = info(tmp_path / "few.mp4", 250)
    assert frames_to_look_at(few) == [6, 18, 31, 43, 56, 68, 81, 93]
    monkeypatch.setattr(sample_pictures, "_MAX_DECODED_PX", 40 * 64 * 48)
    assert frames_to_look_at(few) == [2, 7, 12, 17, 22, 27, 32, 37]


def test_short_video_has_fewer_pictures(tmp_path: Path) -> None:
    assert frames_to_look_at(info(tmp_path / "a.mp4", 1, 3)) == [0, 1, 2]


def test_thumbnails_are_small(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (360, 640, 3), np.uint8)
    videos = {name: [noise] * 3 for name in NAMES}
    paths = session_of(tmp_path / "videos", videos)
    looked = look_at_pictures(open_session(paths, calibration(tmp_path / "c.json", NAMES, (640, 360))))
    for one in looked.thumbnails[0]:
        with av.open(io.BytesIO(one.content)) as picture:
            stream = picture.streams.video[0]
            assert (stream.width, stream.height) == (320, 180)
        assert len(one.content) < 2**17


@pytest.mark.parametrize("budget_s", [0.0, 0.02])
def test_without_time_pictures_are_left_out(
    tmp_path: Path, walks: dict[str, list[np.ndarray]], budget_s: float
) -> None:
    """Before the first decoder starts, and while it starts."""
    paths = session_of(tmp_path / "videos", walks)
    session = open_session(paths, calibration(tmp_path / "c.json", NAMES, SIZE_PX))
    looked = look_at_pictures(session, budget_s)
    (finding,) = looked.findings
    assert (finding.code, finding.severity, finding.evidence) == ("pictures_left_out", "info", {"num_cameras": 2})
    assert looked.thumbnails == ((), ())


def test_video_that_breaks_in_middle_is_finding(
    tmp_path: Path, walks: dict[str, list[np.ndarray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = session_of(tmp_path / "videos", walks)
    session = open_session(paths, calibration(tmp_path / "c.json", NAMES, SIZE_PX))
    # As if the disk failed after the files were opened.
    paths[1].write_bytes(paths[1].read_bytes()[:1000])
    looked = look_at_pictures(session)
    assert [(one.code, one.camera, one.severity) for one in looked.findings] == [("video_damaged", "right", "error")]
    assert [len(one) for one in looked.thumbnails] == [NUM_PICTURES, 0]


def test_decoder_ended_from_outside_leaves_pictures_out(
    tmp_path: Path, walks: dict[str, list[np.ndarray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(video: VideoInfo, *_: object, **__: object) -> NoReturn:
        raise ChildError(f"The decoder of {video.path.name} was ended by SIGKILL.")

    session = open_session(session_of(tmp_path / "videos", walks), calibration(tmp_path / "c.json", NAMES, SIZE_PX))
    monkeypatch.setattr(sample_pictures, "decode", killed)
    (finding,) = look_at_pictures(session).findings
    assert (finding.code, finding.evidence) == ("pictures_left_out", {"num_cameras": 2})
