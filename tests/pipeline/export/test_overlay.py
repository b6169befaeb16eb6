from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.capture.session import CaptureSession
from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import COCO_17, JointSet
from pipeline.export.overlay import draw_skeletons, draw_video, encode_png, overlay_names, people_at
from pipeline.export.scene import color_rgb
from pipeline.geometry.camera import project
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.media import write_pictures
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker, without

GREY = np.full((480, 640, 3), 90, dtype=np.uint8)
# Looks along the world's +Y from 4 m behind the origin, 1 m up, through a lens with distortion.
CAMERA = Camera(
    name="front",
    size_px=(640, 480),
    matrix=np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]),
    distortion=np.array([-0.2, 0.05, 0.001, 0.0]),
    cam_from_world=Rigid3(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.array([0.0, 1.0, 4.0])),
)


def standing(x_m: float) -> np.ndarray:
    return walker(3) - np.array([1.0 - x_m, 2.0, 0.0])


def test_bones_are_drawn_where_camera_sees_them() -> None:
    person_m = standing(0.0)[1]
    image = draw_skeletons(GREY, CAMERA, {1: person_m}, COCO_17)
    hip, knee = (project(CAMERA, person_m[COCO_17.index(name)]) for name in ("left_hip", "left_knee"))
    for share in (0.0, 0.3, 0.5, 0.7, 1.0):
        column, row = np.round(hip + share * (knee - hip)).astype(int)
        np.testing.assert_array_equal(image[row, column], color_rgb(1))
    changed = np.argwhere((image != GREY).any(-1))
    points_px = project(CAMERA, person_m)
    assert np.abs(changed[:, 0].max() - points_px[:, 1].max()) < 8
    assert (GREY == 90).all()


def test_fingers_are_thinner_than_arms() -> None:
    # Two level bones of the same length, one a forearm and the other in a finger.
    level_m = np.array([[-0.5, 0.0, 1.3], [0.5, 0.0, 1.3], [-0.5, 0.0, 0.7], [0.5, 0.0, 0.7]])
    names = ("left_elbow", "left_wrist", "left_index_mcp", "left_index_pip")
    joints = JointSet(names, ((names[0], names[1]), (names[2], names[3])))
    large = replace(CAMERA, size_px=(1920, 1440), matrix=np.diag([3.0, 3.0, 1.0]) @ CAMERA.matrix)
    grey = np.full((1440, 1920, 3), 90, dtype=np.uint8)
    image = draw_skeletons(grey, large, {1: level_m}, joints)
    arm, finger = (np.round(project(large, level_m[pair].mean(0))).astype(int) for pair in ([0, 1], [2, 3]))
    high_arm, high_finger = (
        (image[row - 12 : row + 12, column] != grey[0, 0]).any(-1).sum() for column, row in (arm, finger)
    )
    assert 2 < high_finger < high_arm
    np.testing.assert_array_equal(image[finger[1], finger[0]], color_rgb(1))


def test_name_stands_in_place_of_number() -> None:
    person_m = {7: standing(0.0)[1]}

    def drawn(name: str | None) -> np.ndarray:
        return draw_skeletons(GREY, CAMERA, person_m, COCO_17, {} if name is None else {7: name})

    anna, number = drawn("Anna"), drawn(None)
    above = slice(0, int(np.nanmin(project(CAMERA, person_m[7])[:, 1])) - 10)
    # Four letters are wider than one digit, and nothing else changes.
    widths = [np.ptp(np.nonzero((image[above] != GREY[above]).any((0, 2)))[0]) for image in (anna, number)]
    assert widths[0] > 2 * widths[1]
    np.testing.assert_array_equal(anna[above.stop + 12 :], number[above.stop + 12 :])
    np.testing.assert_array_equal(drawn("Änna".replace("n", "n\u0301")), drawn("Anna"))
    for other in ("\u5c71", "Anna\n", ""):
        np.testing.assert_array_equal(drawn(other), number)
    np.testing.assert_array_equal(drawn("A" * 64), drawn("A" * 24))


def test_people_have_different_colours() -> None:
    people_m = {1: standing(-0.7)[2], 2: standing(0.7)[0]}
    both = draw_skeletons(GREY, CAMERA, people_m, COCO_17)
    for number, xyz_m in people_m.items():
        column, line = np.round(project(CAMERA, xyz_m[COCO_17.index("right_hip")])).astype(int)
        np.testing.assert_array_equal(both[line, column], color_rgb(number))
    colors = np.array([color_rgb(number) for number in range(1, 9)], dtype=float)
    apart = np.linalg.norm(colors[:, None] - colors[None], axis=-1) + 1e3 * np.eye(8)
    assert apart.min() > 50


def test_unseen_joints_and_people_behind_camera_are_left_out() -> None:
    unseen = np.full((17, 3), np.nan)
    behind = standing(0.0)[0] - np.array([0.0, 10.0, 0.0])
    beside = standing(0.0)[0] - np.array([0.0, 4.0 - 1e-5, 0.0])
    np.testing.assert_array_equal(draw_skeletons(GREY, CAMERA, {1: unseen, 2: behind}, COCO_17), GREY)
    draw_skeletons(GREY, CAMERA, {1: beside}, COCO_17)
    image = draw_skeletons(GREY, CAMERA, {1: without(standing(0.0), "left_wrist")[0]}, COCO_17)
    column, row = np.round(project(CAMERA, standing(0.0)[0, COCO_17.index("left_wrist")])).astype(int)
    np.testing.assert_array_equal(image[row, column], GREY[row, column])


def test_png_keeps_every_pixel() -> None:
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    decoded = cv2.imdecode(np.frombuffer(encode_png(image), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    np.testing.assert_array_equal(decoded[..., ::-1], image)


def test_people_are_between_frames_and_near_their_ends() -> None:
    timebase = Timebase(10.0, 25.0, 50)
    xyz_m = np.zeros((3, 2, 3))
    xyz_m[:, 0, 0] = [1.0, 2.0, 4.0]
    xyz_m[:, 1, 0] = [5.0, np.nan, 7.0]
    tracks = [track_of(xyz_m, track_id=7, start_frame=20)]

    def at(frame: float) -> np.ndarray | None:
        found = people_at(tracks, timebase, 10.0 + frame / 25.0)
        return found[7][:, 0] if found else None

    def check(frame: float, expected: list[float]) -> None:
        np.testing.assert_allclose(np.array(at(frame), float), expected)

    check(20.0, [1.0, 5.0])
    # The second joint is unknown in frame 21: up to the middle it stays where it was.
    check(20.25, [1.25, 5.0])
    check(20.75, [1.75, np.nan])
    check(21.6, [3.2, 7.0])
    check(19.51, [1.0, 5.0])
    check(22.49, [4.0, 7.0])
    assert at(19.4) is None
    assert at(22.6) is None


RATE_HZ, OFFSET_S, NUM_FRAMES = 25.0, 0.313, 12
LARGE = replace(CAMERA, size_px=(1600, 1200), matrix=np.diag([2.5, 2.5, 1.0]) @ CAMERA.matrix)
SPEED_M_S = 3.0


def place_m(time_s: float) -> np.ndarray:
    """Place of the only known joint of somebody who runs."""
    return np.array([SPEED_M_S * (time_s - 0.5), 0.3, 1.1])


def runner(num_frames: int = 40) -> Track3D:
    xyz_m = np.full((num_frames, len(COCO_17.names), 3), np.nan)
    xyz_m[:, COCO_17.index("left_wrist")] = [place_m(frame / RATE_HZ) for frame in range(num_frames)]
    return track_of(xyz_m, 3)


def take_of(camera: Camera, timebase: Timebase, track: Track3D) -> Reconstruction:
    return Reconstruction((camera,), COCO_17, timebase, (track,), (), Animation((track,), (), None))


def session_of(camera: Camera, folder: Path) -> CaptureSession:
    grey = np.full((camera.size_px[1], camera.size_px[0], 3), 90, np.uint8)
    video = probe(write_pictures(folder / "front.mp4", [grey] * NUM_FRAMES))
    assert isinstance(video, VideoInfo)
    return CaptureSession((camera,), (video,), {camera.name: FrameTimes(OFFSET_S + video.time_s)}, ())


def drawn_column(image: np.ndarray, row: float) -> float:
    """Column of the middle of what was drawn in some rows."""
    rows = image[round(row) - 3 : round(row) + 4].astype(int)
    return float(np.argwhere((np.abs(rows - 90) > 50).any(-1))[:, 1].mean())


def test_people_are_where_they_were_at_time_of_each_frame(tmp_path: Path) -> None:
    session = session_of(LARGE, tmp_path)
    frames: list[None] = []
    path = tmp_path / "overlay.mp4"
    take = take_of(LARGE, Timebase(0.0, RATE_HZ, 40), runner())
    assert draw_video(session, take, "front", path, lambda: frames.append(None))
    overlay = probe(path)
    assert isinstance(overlay, VideoInfo)
    assert (overlay.browser_media_type, overlay.size_px, len(frames)) == ("video/mp4", (1280, 960), NUM_FRAMES)
    np.testing.assert_allclose(overlay.time_s, session.videos[0].time_s, atol=1e-4)
    num_compared = 0
    for number, image in decode(overlay, 0, NUM_FRAMES):
        # The outer edges of both pictures are the same: pixel -0.5.
        column, row = (project(LARGE, place_m(OFFSET_S + number / RATE_HZ)) + 0.5) * 0.8 - 0.5
        assert drawn_column(image, row) == pytest.approx(column, abs=1.0)
        num_compared += 1
    assert num_compared == NUM_FRAMES


def test_video_is_of_take_alone(tmp_path: Path) -> None:
    session = session_of(CAMERA, tmp_path)
    # Frames 3 to 7 of the camera were taken within half an output frame of these five.
    cut = take_of(CAMERA, Timebase(OFFSET_S + 3 / RATE_HZ, RATE_HZ, 5), runner(5))
    assert draw_video(session, cut, "front", tmp_path / "cut.mp4", lambda: None)
    overlay = probe(tmp_path / "cut.mp4")
    assert isinstance(overlay, VideoInfo)
    np.testing.assert_allclose(overlay.time_s, np.arange(5) / RATE_HZ, atol=1e-4)
    later = take_of(CAMERA, Timebase(60.0, RATE_HZ, 5), runner(5))
    assert not draw_video(session, later, "front", tmp_path / "later.mp4", lambda: None)
    assert not (tmp_path / "later.mp4").exists()


def test_names_are_safe_and_different() -> None:
    hostile = ["a", "A", "../etc", "a%2f", "кам", "", "x" * 300, 'b"<script>']
    names = overlay_names(hostile)
    assert names[:4] == ("overlay-a.mp4", "overlay-A-2.mp4", "overlay-etc.mp4", "overlay-a-2f.mp4")
    assert names[4:6] == ("overlay-camera.mp4", "overlay-camera-2.mp4")
    assert len(names[6]) < 80
    assert len({name.lower() for name in names}) == len(hostile)
    assert all(one.isalnum() or one in "-_." for name in names for one in name)


def test_interrupted_work_ends_at_once(tmp_path: Path) -> None:
    session = session_of(CAMERA, tmp_path)

    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_video(session, take_of(CAMERA, Timebase(0.0, RATE_HZ, 40), runner()), "front", tmp_path / "a.mp4", stop)
