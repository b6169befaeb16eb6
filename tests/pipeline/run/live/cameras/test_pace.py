"""Frames that are detected: the newest of the camera that waits longest, in slots of several frames."""

from collections import Counter
from itertools import pairwise

from pipeline.run.live.cameras.pace import DetectionPace, frames_in_slot


def played(every: int, detection_s: float, num_processes: int = 2, seconds: float = 8.0) -> dict[int, list[float]]:
    """Times of the frames of four cameras at 25 Hz that are detected, each of which takes ``detection_s``."""
    pace, taken = DetectionPace(4, 0.0, 25.0, every), {camera: list[float]() for camera in range(4)}
    busy_until = [0.0] * num_processes
    for frame in range(int(25 * seconds)):
        for camera in range(4):
            pace.announce(camera, frame / 25 + 0.001 * camera)
        for step in range(8):
            now_s = frame / 25 + 0.005 * (step + 1)
            for process in range(num_processes):
                if busy_until[process] <= now_s and (chosen := pace.choose([0, 1, 2, 3])) is not None:
                    taken[chosen].append(frame / 25)
                    busy_until[process] = now_s + detection_s
    return taken


def test_every_frame_is_taken_where_there_is_time() -> None:
    assert {len(times) for times in played(1, 0.01).values()} == {200}


def test_frames_of_one_instant_are_taken_together() -> None:
    taken = played(2, 0.03)
    assert len(set(map(tuple, taken.values()))) == 1
    assert len(taken[0]) == 100


def test_overload_is_shared_evenly() -> None:
    """Half of what is wanted can be detected."""
    taken = played(1, 0.04)
    counts = [len(times) for times in taken.values()]
    assert max(counts) - min(counts) <= 1
    gaps = Counter(round(25 * (after - before)) for times in taken.values() for before, after in pairwise(times))
    assert set(gaps) <= {1, 2, 3}


def test_frames_that_machine_can_detect() -> None:
    assert frames_in_slot(25.0, 4, 100.0) == 1
    assert frames_in_slot(25.0, 4, 99.0) == 2
    assert frames_in_slot(60.0, 4, 1.0) == 12
    assert frames_in_slot(4.0, 4, 1.0) == 1
