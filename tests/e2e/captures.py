"""Small capture sessions as files."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.calibration.write import encode
from pipeline.core.data.cameras import Camera
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.conftest import ring_camera
from tests.pipeline.media import picture, write_pictures, write_video
from tests.pipeline.simulations import write_simulation


def keypoint_capture(folder: Path, duration_s: float = 2.0) -> list[str]:
    """Write simulated people in a room; return the options of `multicap reconstruct` for the files."""
    write_simulation(record(replace(find_scene("room"), duration_s=duration_s), 0, 3), folder)
    timestamps = f"--timestamps={folder / 'timestamps.csv'}"
    return [f"--keypoints={folder / 'keypoints'}", f"--calibration={folder / 'calibration.json'}", timestamps]


def video_capture(folder: Path, num_frames: int = 20) -> list[str]:
    """Write two videos of an empty room; return the options of `multicap reconstruct` for the files."""
    cameras = [replace(ring_camera(name, angle), size_px=(64, 48)) for name, angle in (("left", 0.3), ("right", 1.9))]
    videos = folder / "videos"
    videos.mkdir(parents=True)
    for camera in cameras:
        write_video(videos / f"{camera.name}.mp4", num_frames)
    (folder / "calibration.json").write_bytes(encode(cameras))
    return [f"--videos={videos}", f"--calibration={folder / 'calibration.json'}"]


def two_videos(folder: Path) -> dict[str, Path]:
    """Write two videos of an empty room, and their calibration; the check finds no error."""
    for name in ("left", "right"):
        sign = 1 if name == "left" else -1
        pictures = [picture(3 * number, (64, 48))[::sign, ::sign] for number in range(5)]
        write_pictures(folder / f"{name}.mp4", [image if sign > 0 else 255 - image for image in pictures])
    (folder / "calibration.json").write_bytes(encode(cameras_of_two_videos()))
    return {name: folder / name for name in ("left.mp4", "right.mp4", "calibration.json")}


def cameras_of_two_videos(turn_rad: float = 0.3) -> list[Camera]:
    """Cameras of ``two_videos``; the left one stands at an angle."""
    matrix = np.array([[40.0, 0.0, 31.5], [0.0, 40.0, 23.5], [0.0, 0.0, 1.0]])
    cameras = [ring_camera("left", turn_rad), ring_camera("right", 1.9)]
    return [replace(camera, size_px=(64, 48), matrix=matrix) for camera in cameras]
