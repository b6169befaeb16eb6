"""Calibrate a rig by Caliscope: ``FOLDER OUT COLS ROWS SQUARE_M MARKER_M``, with markers of 4 x 4 bits."""

import json
import sys
from pathlib import Path

from caliscope.api import (
    CameraArray,
    Charuco,
    CharucoTracker,
    calibrate_extrinsics,
    calibrate_intrinsics,
    extract_image_points,
    extract_image_points_multicam,
)


def main(folder: Path, out: Path, cols: int, rows: int, square_m: float, marker_m: float) -> None:
    """Write the centre, in metres, and the focal length of each camera."""
    videos = dict(enumerate(sorted(folder.glob("*.mp4"))))
    board = Charuco.from_squares(cols, rows, 100 * square_m, dictionary="DICT_4X4_50", aruco_scale=marker_m / square_m)
    cameras = CameraArray.from_video_metadata(videos)
    for number, path in videos.items():
        points = extract_image_points(path, number, CharucoTracker(board), progress=None)
        cameras[number] = calibrate_intrinsics(points, cameras[number]).camera
    points = extract_image_points_multicam(videos, CharucoTracker(board), progress=None)
    posed = calibrate_extrinsics(points, cameras, None).capture_volume.camera_array
    found = {
        path.stem: {
            "center_m": (-posed[number].rotation.T @ posed[number].translation.ravel()).tolist(),
            "focal_px": float(posed[number].matrix[0, 0]),
        }
        for number, path in videos.items()
    }
    out.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), *map(float, sys.argv[5:7]))
