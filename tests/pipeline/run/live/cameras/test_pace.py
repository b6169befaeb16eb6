"""Frames that are detected: the newest of the camera that waits longest, in slots of several frames."""

from collections import Counter
from itertools import pairwise

from pipeline.run.live.cameras.pace import DetectionPace, frames_in_slot


def played(
    every: int, detection_s: float, num_processes: int = 2, seconds: float = 8.0, is_judged: bool = False
) -> dict[int, list[float]]:
    """Times of the frames of four cameras at 25 Hz that are detected, each of which takes ``detection_s``."""
    num_detected, pace, taken = 0, DetectionPace(4, 0.0, 25.0, every), {camera: list[float]() for camera in range(4)}
    busy_until, done_s = [0.0] * num_processes, [0.0] * 4
    for frame in range(int(25 * seconds)):
        for camera in range(4):
            pace.announce(camera, frame / 25 + 0.001 * camera)
        for step in range(8):
            now_s = frame / 25 + 0.005 * (step + 1)
            free = [camera for camera in range(4) if done_s[camera] <= now_s]
            # A picture waits while each process works; pictures of a slot of several frames wait together.
            while 4 - len(free) < (num_processes + 1 if pace.every == 1 else 4):
                if (chosen := pace.choose(free)) is None:
                    break
                free.remove(chosen)
                taken[chosen].append(frame / 25)
                process = busy_until.index(min(busy_until))
                busy_until[process] = done_s[chosen] = max(now_s, busy_until[process]) + detection_s
        if is_judged and frame % 25 == 24:
            before, num_detected = num_detected, sum(map(len, taken.values()))
            pace.judge(100, num_detected - before)
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


def test_overload_ends_in_common_instants() -> None:
    taken = [set(times[-20:]) for times in played(1, 0.04, seconds=16.0, is_judged=True).values()]
    assert len(set.intersection(*taken)) >= 18


def test_judged_pace_tries_more_after_a_while() -> None:
    pace, every = DetectionPace(4, 0.0, 25.0, 1), list[int]()
    for second in range(200):
        # The machine detects 60 of 100 frames in the first half minute, and all of them later.
        pace.judge(100, min(100 // pace.every, 60 if second < 30 else 100))
        every.append(pace.every)
    assert max(every) == 2
    assert 1 in every[2:30]
    assert every[-60:] == [1] * 60


def test_frames_that_machine_can_detect() -> None:
    assert frames_in_slot(25.0, 4, 100.0) == 1
    assert frames_in_slot(25.0, 4, 99.0) == 2
    assert frames_in_slot(60.0, 4, 1.0) == 12
    assert frames_in_slot(4.0, 4, 1.0) == 1
