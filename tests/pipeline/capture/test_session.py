"""Sessions from valid and invalid folders: all problems at once, each with its file or camera."""

import io
import json
import shutil
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pipeline.calibration.registry import read_calibration
from pipeline.capture.preflight import main, report
from pipeline.capture.preflight_npz import decode_session
from pipeline.capture.preflight_record import Recording
from pipeline.capture.session import CaptureSession, open_session
from pipeline.core.errors import InputError
from pipeline.video.decode import decode
from tests.pipeline.capture.keypoint_scenes import messages
from tests.pipeline.media import rewrite_packets, write_audio, write_video
from tests.pipeline.video.corpus import write_clip
from tests.pipeline.video.images.test_images import as_folder, as_zip, image
from tests.records import encode_record


def calibration(path: Path, names: list[str], size_px: tuple[int, int] = (64, 48), **changes: Any) -> Path:
    cameras = [
        {
            "name": name,
            "size_px": list(size_px),
            "matrix": [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]],
            "distortion": [],
            "rotation": np.eye(3).tolist(),
            "translation_m": [float(k), 0.0, 3.0],
        }
        | changes
        for k, name in enumerate(names)
    ]
    path.write_text(json.dumps({"schema_version": 1, "cameras": cameras}))
    return path


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("clip") / "clip.mp4", 10)


@pytest.fixture
def folder(tmp_path: Path, clip: Path) -> Path:
    videos = tmp_path / "videos"
    videos.mkdir()
    for name in ("a", "b"):
        shutil.copy(clip, videos / f"{name}.mp4")
    return videos


def problems_of(videos: Any, cameras: Path) -> set[tuple[str, str | None]]:
    """Codes of problems, each with its camera or else its file."""
    with pytest.raises(InputError) as error:
        open_session(videos, cameras)
    for problem in error.value.problems:
        assert str(cameras.parent) not in str(problem)
    return {(problem.code, problem.camera or problem.file) for problem in error.value.problems}


def test_frames_that_repeat_time_are_said(folder: Path, tmp_path: Path) -> None:
    def repeat(number: int, packet: "av.Packet[Any]") -> "list[av.Packet[Any]]":
        packet.pts, packet.dts = 40 * (number - (number == 7)), number - 1000
        return [packet]

    for name in ("a", "b"):
        (folder / f"{name}.mp4").unlink()
    good = write_video(tmp_path / "good.mkv", 30, options={"bf": "0"})
    rewrite_packets(good, folder / "a.mkv", repeat)
    shutil.copy(good, folder / "b.mkv")
    session = open_session(folder, calibration(tmp_path / "c.json", ["a", "b"]))
    left_out, missing = messages(session)
    assert left_out == "a.mkv: 1 frame is left out, because another frame has the same timestamp."
    assert "1 frame is missing, at 0.24 s" in missing


def test_pixels_that_are_not_square_and_fields_are_said(tmp_path: Path) -> None:
    """One calibration is of the shown pictures, one of the stored ones; people are seen at the same places."""
    wide = write_clip(tmp_path, "h264-wide-pixels.mp4").rename(tmp_path / "a.mp4")
    videos = [wide, Path(shutil.copy(wide, tmp_path / "b.mp4"))]
    shown: dict[str, Any] = {"size_px": [128, 64], "matrix": [[96.0, 0.0, 63.5], [0.0, 96.0, 31.5], [0.0, 0.0, 1.0]]}
    stored = {"size_px": [96, 64], "matrix": [[72.0, 0.0, 47.5], [0.0, 96.0, 31.5], [0.0, 0.0, 1.0]]}
    path = calibration(tmp_path / "c.json", ["a", "b"])
    document = json.loads(path.read_text())
    for camera, change in zip(document["cameras"], (shown, stored), strict=True):
        camera.update(change)
    path.write_text(json.dumps(document))
    session = open_session(videos, path)
    for camera in session.cameras:
        assert camera.size_px == (128, 64)
        np.testing.assert_allclose(camera.matrix, shown["matrix"])
    assert [warning.partition(":")[0] for warning in messages(session)] == ["b", "file a.mp4", "file b.mp4"]
    assert "stretched" in messages(session)[0]
    assert "not square (4:3): the pictures are scaled from 96 to 128 columns" in messages(session)[1]
    assert next(decode(session.videos[0], 5, 6))[1].shape == (64, 128, 3)


def test_images_in_place_of_videos(tmp_path: Path) -> None:
    """A folder of folders: one camera has the rate of its recording, the other the session's."""
    images, cameras = tmp_path / "images", calibration(tmp_path / "c.json", ["a.1", "b"])
    images.mkdir()
    for name in ("a.1", "b"):
        as_folder(images / name, {f"{k:03}.png": image(k) for k in range(10) if (name, k) != ("b", 4)})
    (images / "notes").mkdir()
    session = open_session(images, cameras, [Recording("b", offset_s=0.1, frame_rate_hz=50.0)], images_rate_hz=25.0)
    np.testing.assert_allclose(session.times["a.1"].time_s, np.arange(10) / 25)
    np.testing.assert_allclose(session.times["b"].time_s, 0.1 + np.delete(np.arange(10), 4) / 50)
    assert [(one.code, one.camera) for one in session.findings] == [("frames_dropped", "b")]
    again = decode_session(encode_record(session), images)
    assert [number for number, _ in decode(again.videos[1], 3, 6)] == [3, 4, 5]
    with pytest.raises(InputError) as raised:
        open_session([as_zip(images / "b", {"0.png": image(0)}), images / "a.1"], cameras)
    assert [(one.code, one.file, one.camera) for one in raised.value.problems] == [
        ("no_frame_rate", "a.1", "a.1"),
        ("no_frame_rate", "b.zip", "b"),
    ]


@pytest.mark.slow
def test_31_cameras_of_tenth_of_second_are_decoded(tmp_path: Path) -> None:
    clip = write_video(tmp_path / "clip.mp4", 3, rate_hz=30)
    names = [f"cam{k:02}" for k in range(31)]
    videos = [Path(shutil.copy(clip, tmp_path / f"{name}.mp4")) for name in names]
    session = open_session(videos, calibration(tmp_path / "c.json", names))
    assert session.timebase.num_frames == 3
    for video in session.videos:
        assert [number for number, _ in decode(video, 0, 3)] == [0, 1, 2]


def test_videos_match_cameras_by_name_in_calibrations_order(folder: Path, tmp_path: Path) -> None:
    session = open_session(folder, calibration(tmp_path / "c.json", ["b", "a"]))
    assert [camera.name for camera in session.cameras] == ["b", "a"]
    assert [video.path.name for video in session.videos] == ["b.mp4", "a.mp4"]
    assert len(session.times["a"].time_s) == 10
    assert session.findings == ()


def test_paths_may_be_texts(folder: Path, tmp_path: Path) -> None:
    cameras = str(calibration(tmp_path / "c.json", ["a", "b"]))
    videos = [folder / "a.mp4", folder / "b.mp4"]
    for texts in (str(folder), [str(video) for video in videos]):
        assert [video.path for video in open_session(texts, cameras).videos] == videos
    assert problems_of(str(folder / "a.mp4"), Path(cameras)) == {
        ("too_few_videos", None),
        ("camera_without_video", "b"),
    }


def test_order_decides_only_if_it_is_asked_for_and_is_said(folder: Path, tmp_path: Path) -> None:
    cameras = calibration(tmp_path / "c.json", ["right", "left"])
    assert problems_of(folder, cameras) == {("pairing_unknown", None)}
    session = open_session(folder, cameras, pair_by_order=True)
    pairs = {camera.name: video.path.name for camera, video in zip(session.cameras, session.videos, strict=True)}
    assert pairs == {"left": "a.mp4", "right": "b.mp4"}
    (warning,) = messages(session)
    assert "left: a, right: b" in warning


def test_never_half_by_name_half_by_order(folder: Path, tmp_path: Path) -> None:
    assert problems_of(folder, calibration(tmp_path / "c.json", ["a", "other"])) == {
        ("camera_without_video", "other"),
        ("video_without_camera", "b"),
    }


def test_calibration_with_camera_too_few_or_too_many(folder: Path, tmp_path: Path) -> None:
    assert problems_of(folder, calibration(tmp_path / "c.json", ["a"])) == {("video_without_camera", "b")}
    session = open_session(folder, calibration(tmp_path / "c.json", ["c", "a", "b"]))
    assert [camera.name for camera in session.cameras] == ["a", "b"]
    assert messages(session) == ["The camera c of the calibration has no video: it is left out."]


def test_camera_with_recording_is_not_left_out(folder: Path, tmp_path: Path) -> None:
    cameras = calibration(tmp_path / "c.json", ["a", "b", "c"])
    with pytest.raises(InputError) as error:
        open_session(folder, cameras, [Recording("c", offset_s=0.5)])
    assert [(problem.code, problem.camera) for problem in error.value.problems] == [("camera_without_video", "c")]


def test_other_files_in_folder_are_ignored_and_said(folder: Path, tmp_path: Path) -> None:
    (folder / "notes.txt").write_text("hello")
    session = open_session(folder, calibration(tmp_path / "c.json", ["a", "b"]))
    assert messages(session) == ["notes.txt is ignored: it is not a video."]


def test_no_video_and_one_video(folder: Path, tmp_path: Path) -> None:
    cameras = calibration(tmp_path / "c.json", ["a", "b"])
    (folder / "b.mp4").unlink()
    assert ("too_few_videos", None) in problems_of(folder, cameras)
    (folder / "a.mp4").unlink()
    assert ("too_few_videos", None) in problems_of(folder, cameras)


def test_two_videos_with_same_name(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "a.mp4", folder / "a.mov")
    cameras = calibration(tmp_path / "c.json", ["a", "b"])
    assert problems_of(folder, cameras) == {("duplicate_video", "a")}
    same = [folder / "a.mp4", folder / "a.mp4", folder / "b.mp4"]
    assert problems_of(same, cameras) == {("duplicate_video", "a")}


def test_video_and_calibration_of_different_size(folder: Path, tmp_path: Path) -> None:
    cameras = calibration(tmp_path / "c.json", ["a", "b"], size_px=(48, 64))
    assert problems_of(folder, cameras) == {("size_mismatch", "a"), ("size_mismatch", "b")}
    with pytest.raises(InputError, match="does not say in which direction"):
        open_session(folder, cameras)
    assert problems_of(folder, calibration(tmp_path / "c.json", ["a", "b"], size_px=(64, 30))) == {
        ("size_mismatch", "a"),
        ("size_mismatch", "b"),
    }


def test_calibration_of_another_size_is_adapted_with_warning(folder: Path, tmp_path: Path) -> None:
    session = open_session(folder, calibration(tmp_path / "c.json", ["a", "b"], size_px=(128, 96)))
    assert messages(session) == [
        "a: the video has 64 x 48 pixels, the calibration 128 x 96; the calibration is scaled by 0.5.",
        "b: the video has 64 x 48 pixels, the calibration 128 x 96; the calibration is scaled by 0.5.",
    ]
    for camera in session.cameras:
        assert camera.size_px == (64, 48)
        np.testing.assert_allclose(camera.matrix, [[25.0, 0.0, 15.5], [0.0, 25.0, 11.5], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("size_px", [(65, 49), (63, 47)])
def test_calibration_one_pixel_off_takes_video_size(folder: Path, tmp_path: Path, size_px: tuple[int, int]) -> None:
    path = calibration(tmp_path / "c.json", ["a", "b"], size_px=size_px)
    session = open_session(folder, path)
    for camera, stated in zip(session.cameras, read_calibration(path), strict=True):
        assert camera.size_px == (64, 48)
        np.testing.assert_array_equal(camera.matrix, stated.matrix)
    assert [finding.code for finding in session.findings] == ["calibration_adapted"] * 2


def test_calibration_without_sizes_takes_those_of_videos(folder: Path, tmp_path: Path) -> None:
    def voxelpose(principal_px: float) -> dict[str, Any]:
        lens = {"fx": 50.0, "fy": 50.0, "cx": principal_px, "cy": 23.5, "k": [0.0] * 3, "p": [0.0] * 2}
        return {"R": np.eye(3).tolist(), "T": [0.0, 0.0, -3000.0], **lens}

    cameras = tmp_path / "calibration.json"
    cameras.write_text(json.dumps({"a": voxelpose(31.5), "b": voxelpose(30.0)}))
    session = open_session(folder, cameras)
    assert [camera.size_px for camera in session.cameras] == [(64, 48)] * 2
    assert messages(session)[0] == (
        "a: the video has 64 x 48 pixels, the calibration does not contain a size; the video's size is taken."
    )
    cameras.write_text(json.dumps({"a": voxelpose(31.5), "b": voxelpose(960.0)}))
    assert problems_of(folder, cameras) == {("size_mismatch", "b")}


def test_everything_wrong_is_said_at_once(folder: Path, tmp_path: Path) -> None:
    write_audio(folder / "c.mp4")
    (folder / "d.mp4").write_text("no video")
    content = (folder / "b.mp4").read_bytes()
    (folder / "b.mp4").write_bytes(content[: len(content) // 2])
    cameras = calibration(tmp_path / "c.json", ["a", "b", "c", "d"], rotation=np.diag([1.0, 1.0, 2.0]).tolist())
    assert problems_of(folder, cameras) == {
        ("no_video_stream", "c.mp4"),
        ("video_unreadable", "d.mp4"),
        ("video_unreadable", "b.mp4"),
        *(("invalid_rotation", name) for name in "abcd"),
    }


def test_folder_that_is_not_there(tmp_path: Path) -> None:
    cameras = calibration(tmp_path / "c.json", ["a", "b"])
    assert ("video_missing", "nowhere") in problems_of(tmp_path / "nowhere", cameras)


class TestRecordings:
    """Information about videos that neither the videos nor the calibration hold."""

    def test_offsets_shift_camera_s_times(self, folder: Path, tmp_path: Path) -> None:
        cameras = calibration(tmp_path / "c.json", ["a", "b"])
        plain = open_session(folder, cameras)
        shifted = open_session(folder, cameras, [Recording("b", offset_s=-0.2), Recording("a", offset_s=0.04)])
        np.testing.assert_allclose(shifted.times["b"].time_s, plain.times["b"].time_s - 0.2)
        np.testing.assert_allclose(shifted.times["a"].time_s, plain.times["a"].time_s + 0.04)
        assert shifted.timebase.start_time_s == pytest.approx(-0.2)
        assert shifted.timebase.num_frames == plain.timebase.num_frames + 6  # 25 frames a second
        np.testing.assert_array_equal(shifted.videos[1].time_s, plain.videos[1].time_s)  # frames are found as before

    def test_rate_replaces_times_of_video(self, folder: Path, tmp_path: Path) -> None:
        cameras = calibration(tmp_path / "c.json", ["a", "b"])
        session = open_session(folder, cameras, [Recording("a", frame_rate_hz=50.0, offset_s=0.1)])
        np.testing.assert_allclose(session.times["a"].time_s, 0.1 + np.arange(10) / 50.0)
        assert session.timebase.frame_rate_hz == 50.0

    def test_slow_motion_is_named_until_its_rate_is_stated(self, folder: Path, tmp_path: Path) -> None:
        write_video(folder / "b.mp4", 40)
        cameras = calibration(tmp_path / "c.json", ["a", "b"])
        session = open_session(folder, cameras)
        (finding,) = session.findings
        assert (finding.code, finding.camera) == ("slow_motion", "b")
        assert "filmed at 100 Hz, stored at 25 Hz" in finding.message
        session = open_session(folder, cameras, [Recording("b", frame_rate_hz=100.0)])
        assert session.findings == ()
        assert session.times["b"].time_s[-1] == pytest.approx(0.39)

    @pytest.mark.parametrize("rate_hz", [1.0, 1000.0])
    @pytest.mark.parametrize("offset_s", [0.0, 0.1, 0.25])
    def test_limits_of_rates_are_taken_whatever_offset(
        self, folder: Path, tmp_path: Path, rate_hz: float, offset_s: float
    ) -> None:
        """A start at 0.1 s turns 1000 Hz into 1000.0000000000002 Hz by rounding."""
        said = [Recording(name, frame_rate_hz=rate_hz, offset_s=offset_s) for name in ("a", "b")]
        session = open_session(folder, calibration(tmp_path / "c.json", ["a", "b"]), said)
        assert session.timebase.frame_rate_hz == rate_hz

    @pytest.mark.parametrize("rate_hz", [0.99, 1010.0])
    def test_rates_beyond_limits_are_refused(self, folder: Path, tmp_path: Path, rate_hz: float) -> None:
        with pytest.raises(InputError) as error:
            open_session(folder, calibration(tmp_path / "c.json", ["a", "b"]), [Recording("a", frame_rate_hz=rate_hz)])
        assert [problem.code for problem in error.value.problems] == ["frame_rate"]

    def test_files_are_cameras_that_they_are_said_to_be(self, folder: Path, tmp_path: Path) -> None:
        cameras = calibration(tmp_path / "c.json", ["left", "right"])
        session = open_session(folder, cameras, [Recording("left", "b.mp4"), Recording("right", "a.mp4")])
        assert [video.path.name for video in session.videos] == ["b.mp4", "a.mp4"]
        assert session.findings == ()
        paths = [Recording("left", str(folder / "b.mp4")), Recording("right", str(folder / "a.mp4"))]
        assert open_session(folder, cameras, paths).camera_videos["left"].path.name == "b.mp4"
        some = calibration(tmp_path / "d.json", ["a", "right"])
        session = open_session(folder, some, [Recording("right", "b.mp4")])
        assert [video.path.name for video in session.videos] == ["a.mp4", "b.mp4"]

    def test_accents_of_file_may_be_composed_or_not(self, folder: Path, tmp_path: Path) -> None:
        (folder / "a.mp4").rename(folder / "Cafe\u0301.mp4")
        cameras = calibration(tmp_path / "c.json", ["left", "b"])
        session = open_session(folder, cameras, [Recording("left", "Caf\u00e9.mp4")])
        assert session.camera_videos["left"].path.name == "Cafe\u0301.mp4"

    @pytest.mark.parametrize(
        ("recordings", "found"),
        [
            ([Recording("c")], {("recording_camera_unknown", "c")}),
            ([Recording("a"), Recording("a", offset_s=1.0)], {("duplicate_recording", "a")}),
            (
                [Recording("a", "c.mp4"), Recording("d")],
                {("recording_file_unknown", "a"), ("recording_camera_unknown", "d")},
            ),
            ([Recording("a", "b.mp4"), Recording("b", "b.mp4")], {("duplicate_recording_file", "b")}),
            ([Recording("a", "b.mp4")], {("camera_with_two_videos", "a"), ("camera_without_video", "b")}),
            ([Recording("a", offset_s=100.0)], {("no_overlap", "a"), ("no_overlap", "b")}),
            ([Recording("a", offset_s=-86_400.0)], {("no_overlap", "a"), ("no_overlap", "b")}),
            (
                [Recording("a", offset_s=86_401.0), Recording("b", offset_s=float("nan"), frame_rate_hz=float("inf"))],
                {("offset_range", "a"), ("offset_range", "b"), ("frame_rate", "b")},
            ),
        ],
    )  # fmt: skip
    def test_impossible_values_are_refused(
        self, folder: Path, tmp_path: Path, recordings: list[Recording], found: set[tuple[str, str]]
    ) -> None:
        with pytest.raises(InputError) as error:
            open_session(folder, calibration(tmp_path / "c.json", ["a", "b"]), recordings)
        assert {(problem.code, problem.camera) for problem in error.value.problems} == found

    def test_offsets_of_days_with_rate_of_1000(self, folder: Path, tmp_path: Path) -> None:
        """Videos of ten frames give 172 million output frames."""
        for name in ("c", "d"):
            shutil.copy(folder / "a.mp4", folder / f"{name}.mp4")
        cameras = calibration(tmp_path / "c.json", ["a", "b", "c", "d"])
        offsets_s = {"a": -86_400.0, "b": -86_400.0, "c": 86_400.0, "d": 86_400.0}
        stated = [Recording(name, offset_s=offset_s, frame_rate_hz=1000.0) for name, offset_s in offsets_s.items()]
        with pytest.raises(InputError) as error:
            open_session(folder, cameras, stated)
        (problem,) = error.value.problems
        assert (problem.code, problem.file, problem.camera, problem.field) == (
            "session_too_long",
            "c.mp4",
            "c",
            "offset_s",
        )

    def test_cameras_that_start_much_later(self, folder: Path, tmp_path: Path) -> None:
        for name in ("c", "d"):
            shutil.copy(folder / "a.mp4", folder / f"{name}.mp4")
        cameras = calibration(tmp_path / "c.json", ["a", "b", "c", "d"])
        session = open_session(folder, cameras, [Recording(name, offset_s=36_000.0) for name in ("c", "d")])
        assert session.timebase.num_frames == 900_010
        assert session.stretches == (range(11), range(899_999, 900_010))


class TestTimesOfVideos:
    """Uneven frames are accepted; a video of several days is not."""

    def open(self, tmp_path: Path, stamps_ms: list[int], ending: str = "mp4") -> CaptureSession:
        videos = [write_video(tmp_path / f"{name}.{ending}", len(stamps_ms), stamps=stamps_ms) for name in ("a", "b")]
        return open_session(videos, calibration(tmp_path / "c.json", ["a", "b"]))

    @pytest.mark.parametrize("ending", ["mp4", "mkv"])
    def test_24_frames_second_on_clock_of_60_hz(self, tmp_path: Path, ending: str) -> None:
        ticks = np.floor(np.arange(97) * 2.5)
        session = self.open(tmp_path, [round(tick * 1000 / 60) for tick in ticks], ending)
        assert session.timebase.frame_rate_hz == 24.0
        assert session.timebase.num_frames == 97

    @pytest.mark.parametrize("ending", ["mp4", "mkv"])
    def test_phone_s_frames_that_jitter(self, tmp_path: Path, ending: str) -> None:
        jitter_s = np.random.default_rng(3).uniform(-0.004, 0.004, 90)
        jitter_s[[0, -1]] = 0.0
        session = self.open(
            tmp_path, np.round(1000 * (np.arange(90) * 1001 / 30_000 + jitter_s)).astype(int).tolist(), ending
        )
        assert session.timebase.frame_rate_hz == pytest.approx(30_000 / 1001, rel=1e-3)
        assert session.timebase.num_frames == 90

    def test_rate_of_ntsc_is_shown_without_rounding(self, tmp_path: Path) -> None:
        stamps_ms = [round(number * 1001 / 30) for number in range(100)]
        session = self.open(tmp_path, stamps_ms, "mkv")
        shown = json.dumps(report(session, ["a.mkv", "b.mkv"], "m").to_json())
        assert shown.count('"frame_rate_hz": 29.97002997002997,') == 3

    @pytest.mark.parametrize("num_frames", [2, 3])
    def test_tenth_of_second(self, tmp_path: Path, num_frames: int) -> None:
        session = self.open(tmp_path, [0, 40, 80][:num_frames])
        assert session.timebase.frame_rate_hz == 25.0
        assert session.timebase.num_frames == num_frames

    def test_pause_within_videos(self, tmp_path: Path) -> None:
        session = self.open(tmp_path, [*range(0, 400, 40), *range(3_600_000, 3_600_400, 40)])
        assert session.timebase.num_frames == 90_010
        assert session.stretches == (range(11), range(89_999, 90_010))

    def test_one_time_of_two_days(self, tmp_path: Path) -> None:
        with pytest.raises(InputError) as error:
            self.open(tmp_path, [*range(0, 400, 40), 172_800_000], "mkv")
        assert [(one.code, one.file, one.camera, one.field) for one in error.value.problems] == [
            ("session_too_long", "a.mkv", "a", "rate"),
            ("session_too_long", "b.mkv", "b", "rate"),
        ]


def test_intrinsics_need_neither_poses_nor_unit(folder: Path, tmp_path: Path) -> None:
    """Footage of a calibration that is to be made, with lenses that are known."""
    alone = tmp_path / "intrinsics.toml"
    lens = "size = [64, 48]\nmatrix = [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]]\n"
    sections = [f"[{name}]\n{lens}" for name in "ab"]
    alone.write_text("".join(sections))
    in_mm = tmp_path / "in_mm.toml"
    poses = [f"rotation = [0, 0, 0]\ntranslation = [{1e4 * k}, 0, 0]\n" for k in range(2)]
    in_mm.write_text("".join(section + pose for section, pose in zip(sections, poses, strict=True)))
    assert problems_of(folder, alone) == {("calibration_unposed", "intrinsics.toml")}
    assert problems_of(folder, in_mm) == {("calibration_units_unstated", "in_mm.toml")}
    for path in (alone, in_mm):
        session = open_session(folder, path, keeps_poses=False)
        assert [camera.name for camera in session.cameras] == ["a", "b"]
        np.testing.assert_array_equal(session.cameras[1].matrix.diagonal(), [50.0, 50.0, 1.0])


@pytest.mark.parametrize("part", ["calibration", "intrinsics"])
def test_check_takes_intrinsics_alone_in_their_own_part(folder: Path, tmp_path: Path, part: str) -> None:
    alone = tmp_path / "lens.toml"
    alone.write_text(
        "".join(f"[{n}]\nsize = [64, 48]\nmatrix = [[50, 0, 31.5], [0, 50, 23.5], [0, 0, 1]]\n" for n in "ab")
    )
    words = ["--videos", *map(str, sorted(folder.iterdir())), f"--{part}", str(alone)]
    output = io.StringIO()
    with redirect_stdout(output):
        code = main(words)
    answer = json.loads(output.getvalue())
    if part == "calibration":
        assert (code, [problem["code"] for problem in answer["problems"]]) == (2, ["calibration_unposed"])
    else:
        assert (code, [camera["name"] for camera in answer["cameras"]]) == (0, ["a", "b"])
