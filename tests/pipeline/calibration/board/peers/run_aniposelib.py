"""Calibrate a rig by aniposelib: ``FOLDER OUT COLS ROWS SQUARE_M MARKER_M``, with markers of 4 x 4 bits."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
from aniposelib.boards import CharucoBoard
from aniposelib.cameras import CameraGroup


def main(folder: Path, out: Path, cols: int, rows: int, square_m: float, marker_m: float) -> None:
    """Write the centre, in metres, and the focal length of each camera."""
    videos = sorted(folder.glob("*.mp4"))
    board = CharucoBoard(cols, rows, square_length=square_m, marker_length=marker_m, marker_bits=4, dict_size=50)
    group = CameraGroup.from_names([path.stem for path in videos])
    group.calibrate_videos([[str(path)] for path in videos], board, verbose=False)
    found = {}
    for camera in group.cameras:
        rotation, _ = cv2.Rodrigues(np.array(camera.get_rotation()))
        center_m = -rotation.T @ np.array(camera.get_translation())
        found[camera.get_name()] = {"center_m": center_m.tolist(), "focal_px": float(camera.get_camera_matrix()[0, 0])}
    out.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), *map(float, sys.argv[5:7]))
