"""Small capture sessions as files."""

from dataclasses import replace
from pathlib import Path

from pipeline.calibration.write import encode
from pipeline.simulation.scenes import find_scene, record
from tests.pipeline.conftest import ring_camera
from tests.pipeline.media import write_video
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
