"""2D joints of a studio: a line a person with the number of the frame, then x, y and score of COCO's 17 joints."""

from pathlib import Path

import numpy as np

from multicap import KeypointReading, KeypointsError, keypoint_reader


def split_frames(content: str) -> dict[int, list[list[float]]]:
    """Split the lines by their frames."""
    frames: dict[int, list[list[float]]] = {}
    for line in content.splitlines():
        number, *words = line.split()
        try:
            frames.setdefault(int(number), []).append([float(word) for word in words])
        except ValueError:
            raise KeypointsError("A line has words that are not numbers.") from None
    return frames


@keypoint_reader("Studio", suffixes=(".joints",), load=Path.read_text, split_frames=split_frames)
def read_frame(people: list[list[float]], reading: KeypointReading) -> np.ndarray:
    """Read the people of a frame."""
    if any(len(numbers) != 51 for numbers in people):
        raise KeypointsError("A line must have x, y and score of 17 joints.")
    return reading.people(np.reshape(people, (-1, 17, 3)), reading.layout(17, "joints"))
