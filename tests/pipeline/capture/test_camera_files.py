"""Files of videos: folders, parts of recordings, and files that are passed over."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.preflight import report
from pipeline.capture.preflight_npz import decode_session
from pipeline.capture.preflight_record import Preflight, Recording
from pipeline.capture.session import CaptureSession, open_session
from pipeline.core.errors import InputError
from pipeline.video.decode import decode
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.media import cut_at_keyframes, write_video
from tests.records import encode_record

GROUPS = {"g": "8", "keyint_min": "8", "sc_threshold": "0"}


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("clip") / "clip.mp4", 24, options=GROUPS)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    return calibration(tmp_path / "c.json", ["left", "right"])


def files_of(session: CaptureSession) -> dict[str, list[str]]:
    return {camera: [path.name for path in video.paths] for camera, video in session.camera_videos.items()}


def codes(session: CaptureSession) -> set[str]:
    return {finding.code for finding in session.findings}


def problems(*arguments: object, **options: object) -> list[tuple[str, str | None]]:
    with pytest.raises(InputError) as raised:
        open_session(*arguments, **options)  # type: ignore[arg-type]
    return [(problem.code, problem.file) for problem in raised.value.problems]


class TestParts:
    @pytest.fixture
    def folder(self, clip: Path, tmp_path: Path) -> Path:
        folder = tmp_path / "videos"
        folder.mkdir()
        shutil.copy(clip, folder / "right.mp4")
        cut_at_keyframes(clip, [folder / f"left_GX0{number}0119.MP4" for number in (1, 2, 3)])
        return folder

    def test_chapters_are_one_video(self, folder: Path, rig: Path) -> None:
        session = open_session(folder, rig)
        names = [f"left_GX0{number}0119.MP4" for number in (1, 2, 3)]
        assert files_of(session) == {"left": names, "right": ["right.mp4"]}
        np.testing.assert_array_equal(session.times["left"].time_s, session.times["right"].time_s)
        (finding,) = session.findings
        assert (finding.code, finding.camera, finding.severity) == ("parts_joined", "left", "info")
        assert finding.evidence == {"files": names}
        assert ", ".join(names) in finding.message

    def test_record_keeps_them(self, folder: Path, rig: Path) -> None:
        session = open_session(folder, rig, [Recording("left", offset_s=0.04, offset_std_s=0.002)])
        again = decode_session(encode_record(session), folder)
        assert files_of(again) == files_of(session)
        assert again.offset_std_s == session.offset_std_s == {"left": 0.002}
        for one, other in zip(decode(again.videos[0], 6, 18), decode(session.videos[1], 6, 18), strict=True):
            np.testing.assert_array_equal(one[1], other[1])
        files = [[path.name for path in video.paths] for video in session.videos]
        preflight = report(session, files, "m", [Recording("left", "a.mp4", more_files=("b.mp4",))])
        assert preflight.cameras[0].more_files == ("left_GX020119.MP4", "left_GX030119.MP4")
        assert Preflight.from_json(preflight.to_json()) == preflight

    def test_missing_chapter_is_named(self, folder: Path, rig: Path) -> None:
        (folder / "left_GX020119.MP4").unlink()
        assert problems(folder, rig) == [("parts_gap", "left_GX010119")]

    def test_first_chapter_may_be_left_out(self, folder: Path, rig: Path) -> None:
        (folder / "left_GX010119.MP4").unlink()
        assert files_of(open_session(folder, rig))["left"] == ["left_GX020119.MP4", "left_GX030119.MP4"]

    def test_seam_that_does_not_fit_is_refused(self, folder: Path, rig: Path) -> None:
        write_video(folder / "left_GX020119.MP4", 8, (80, 48))
        assert problems(folder, rig) == [("parts_differ", "left_GX020119.MP4")]

    def test_stated_parts_need_no_names(self, clip: Path, folder: Path, rig: Path) -> None:
        others = cut_at_keyframes(clip, [folder / name for name in ("C0009.MP4", "C0010.MP4")])
        files = [others[1], folder / "right.mp4", others[0]]
        assert problems(files, rig)[0] == ("camera_without_video", None)
        session = open_session(files, rig, [Recording("left", "C0009.MP4", more_files=("C0010.MP4",))])
        assert files_of(session)["left"] == ["C0009.MP4", "C0010.MP4"]
        wrong = [Recording("left", "C0009.MP4", more_files=("C0009.MP4", "C0011.MP4"))]
        assert problems(files, rig, wrong) == [
            ("recording_file_unknown", "C0011.MP4"),
            ("duplicate_recording_file", "C0009.MP4"),
        ]

    def test_chapters_follow_one_that_is_stated(self, clip: Path, tmp_path: Path, rig: Path) -> None:
        parts = cut_at_keyframes(clip, [tmp_path / f"GX0{number}0042.MP4" for number in (1, 2, 3)])
        other = shutil.copy(clip, tmp_path / "GX010077.MP4")
        stated = [Recording("right", parts[0].name), Recording("left", "GX010077.MP4")]
        session = open_session([*parts, Path(other)], rig, stated)
        assert files_of(session) == {"left": ["GX010077.MP4"], "right": [path.name for path in parts]}
        session = open_session([*parts, Path(other)], rig, [], pair_by_order=True)
        assert files_of(session) == {"left": [path.name for path in parts], "right": ["GX010077.MP4"]}

    def test_names_of_cameras_go_before_numbers_of_parts(self, clip: Path, tmp_path: Path) -> None:
        cameras = calibration(tmp_path / "c.json", ["part 1", "part 2"])
        videos = [Path(shutil.copy(clip, tmp_path / f"walk_part_{number}.mp4")) for number in (1, 2)]
        assert files_of(open_session(videos, cameras)) == {
            "part 1": ["walk_part_1.mp4"],
            "part 2": ["walk_part_2.mp4"],
        }

    def test_calibration_to_be_made_has_camera_for_all_parts(self, folder: Path) -> None:
        session = open_session(folder, None, [Recording("door", "right.mp4")])
        assert files_of(session) == {
            "left_GX010119": [f"left_GX0{number}0119.MP4" for number in (1, 2, 3)],
            "door": ["right.mp4"],
        }


class TestFolders:
    def test_cameras_have_folders_with_folders_of_their_cards(self, clip: Path, tmp_path: Path, rig: Path) -> None:
        videos = tmp_path / "videos"
        for camera in ("left", "right"):
            card = videos / camera / "DCIM" / "100GOPRO"
            card.mkdir(parents=True)
            cut_at_keyframes(clip, [card / "GX010001.MP4", card / "GX020001.MP4"])
        session = open_session(videos, rig)
        chapters = ["GX010001.MP4", "GX020001.MP4"]
        assert files_of(session) == {"left": chapters, "right": chapters}
        assert session.camera_videos["left"].path.parts[-4] == "left"
        files = sorted(videos.rglob("*.MP4"))
        assert open_session(files, rig).camera_videos["right"].path.parts[-4] == "right"
        stated = [Recording("left", str(files[2])), Recording("right", str(files[0]))]
        assert open_session(files, rig, stated).camera_videos["right"].path.parts[-4] == "left"

    def test_files_of_one_name_have_those_of_their_folders(self, clip: Path, tmp_path: Path, rig: Path) -> None:
        files = []
        for camera in ("right", "left"):
            (tmp_path / camera).mkdir()
            files.append(Path(shutil.copy(clip, tmp_path / camera / "video.mp4")))
        assert open_session(files, rig).camera_videos["left"].path.parent.name == "left"


class TestPassedOver:
    def test_files_beside_videos_are_named_once(self, clip: Path, tmp_path: Path, rig: Path) -> None:
        videos = tmp_path / "videos"
        (videos / "__MACOSX").mkdir(parents=True)
        for name in ("left.mp4", "right.mp4"):
            shutil.copy(clip, videos / name)
        for name in ("._left.mp4", "._right.mp4", "left.LRV", "left.THM", "VID_001.insv", ".DS_Store"):
            (videos / name).write_bytes(b"\0")
        session = open_session(videos, rig)
        assert files_of(session) == {"left": ["left.mp4"], "right": ["right.mp4"]}
        (finding,) = session.findings
        assert (finding.code, finding.severity) == ("file_ignored", "info")
        assert finding.message.endswith(": ._left.mp4, ._right.mp4, VID_001.insv, __MACOSX, left.LRV, left.THM.")
        given = [path for path in videos.iterdir() if path.is_file() and path.name != ".DS_Store"]
        assert codes(open_session(given, rig)) == {"file_ignored"}
