"""Find one person in each window of videos by MediaPipe's Pose: ``VIDEOS WINDOWS OUT``."""

import json
import resource
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mediapipe.python.solutions.pose import Pose


def main(videos: Path, windows: Path, out: Path) -> None:
    """Write joints of each window by frame: x, y and visibility of 33 landmarks; NaN where nobody is found.

    ``WINDOWS`` holds left, top, right and bottom of each window in pixels, by the name of the camera.
    """
    content: dict[str, Any] = {}
    total_s = 0.0
    for camera, boxes in json.loads(windows.read_text()).items():
        pictures = decoded(videos / f"{camera}.mp4")
        found = np.full((len(boxes), len(pictures), 33, 3), np.nan)
        for number, (left, top, right, bottom) in enumerate(boxes):
            crops = [np.ascontiguousarray(picture[top:bottom, left:right]) for picture in pictures]
            # The network `full`, which the package contains.
            with Pose(model_complexity=1) as pose:
                started_s = core_s()
                results = [pose.process(crop).pose_landmarks for crop in crops]
                total_s += core_s() - started_s
            for frame, landmarks in enumerate(results):
                if landmarks is not None:
                    points = np.array([(mark.x, mark.y, mark.visibility) for mark in landmarks.landmark])
                    # Pixel centres are whole numbers; MediaPipe's 0 and 1 are edges of the picture.
                    size = right - left, bottom - top, 1.0
                    found[number, frame] = points * size + (left - 0.5, top - 0.5, 0.0)
        content[camera] = found
    np.savez(out, core_s=total_s, **content)


def decoded(video: Path) -> list[np.ndarray]:
    """All pictures of a video, RGB."""
    capture = cv2.VideoCapture(str(video))
    pictures = []
    while (read := capture.read())[0]:
        pictures.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))
    return pictures


def core_s() -> float:
    """Seconds of a core that this process has taken, in all of its threads."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
