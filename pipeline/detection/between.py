"""Bodies in the frames between two detections.

Networks are the costly part. Where two detections, a few hundredths of a second apart, show the same bodies and these
moved little, their joints in the frames between are interpolated. Where the two detections differ, the frame in the
middle is detected too.

Frames for detection follow from the camera's times alone, and all else from the pictures between two of them. So it
does not matter how frames are cut into ranges: a range begins at the detection before its first frame, and ends at the
detection after its last one.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.core.data.arrays import read_only
from pipeline.detection.bodies import BodyDetector, ImageBodies

Picture = tuple[int, UInt8[np.ndarray, "height width 3"]]
"""Number of a frame, and its picture."""
NumberedPictureBodies = tuple[int, UInt8[np.ndarray, "height width 3"], ImageBodies]
"""Number of a frame, its picture, and the joints that the detector has or would have there."""

# Frames from one detection to the next at most: the pictures between are kept in memory.
_MAX_FRAMES = 4
# Times of frames are rounded, some to microseconds.
_SLACK_S = 1e-4
# Joints that make two bodies comparable: their least score, and their least number.
_MIN_SCORE, _MIN_JOINTS = 0.2, 5
# Largest distance of a joint of one body in two detections, as a share of the body's size.
_MAX_STEP = 0.1
# Least score of a joint whose larger step is motion. Of other joints it is a wrong detection in one of both.
_SURE_SCORE = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class DetectionSchedule:
    """Frames of a camera that are detected in any case, around a range of frames."""

    time_s: Float[np.ndarray, " frames"]  # Times of all frames of the camera, ascending
    # Numbers of the frames, ascending. The first one is not after the range's first frame, the last one not before the
    # range's last frame.
    detected: tuple[int, ...]

    @property
    def frames(self) -> range:
        """Frames whose pictures are needed."""
        return range(self.detected[0], self.detected[-1] + 1)

    def gap(self, frame: int) -> int:
        """Return the number of scheduled frames before a frame: of the gap between two that it is in, or closes."""
        return bisect_left(self.detected, frame)

    def share(self, before: int, frame: int, after: int) -> float:
        """Place of a frame's time between the times of two frames, from 0 to 1."""
        start_s, time_s, end_s = self.time_s[[before, frame, after]]
        return float((time_s - start_s) / (end_s - start_s)) if end_s > start_s else 0.5


def schedule_detections(time_s: Float[np.ndarray, " frames"], frames: range, longest_s: float) -> DetectionSchedule:
    """Choose the frames of a camera that are detected in any case.

    Each second since the camera's first frame begins with a detection. Each further detection is the last frame that is
    at most ``longest_s`` after the one before, or the next frame, and at most four frames away.

    ``time_s``: times of all frames of the camera, ascending. ``frames``: range of frames that is wanted, not empty. The
    frames that are chosen in it do not depend on its ends. ``longest_s``: longest time between two detections.
    """
    second = np.floor(time_s - time_s[0])
    last = min(int(np.searchsorted(second, second[frames.stop - 1], "right")), len(time_s) - 1)
    detected = [int(np.searchsorted(second, second[frames.start]))]
    while detected[-1] < min(last, frames.stop - 1):
        frame = detected[-1]
        reach = int(np.searchsorted(time_s, time_s[frame] + longest_s + _SLACK_S, "right")) - 1
        next_second = int(np.searchsorted(second, second[frame], "right"))
        detected.append(min(max(reach, frame + 1), frame + _MAX_FRAMES, next_second, last))
    first = max(frame for frame in detected if frame <= frames.start)
    return DetectionSchedule(time_s, tuple(frame for frame in detected if frame >= first))


def bodies_between(
    images: Iterable[Picture], detector: BodyDetector, schedule: DetectionSchedule
) -> Iterator[NumberedPictureBodies]:
    """Detect bodies in the scheduled frames, and in those between as far as they can't be interpolated.

    ``images``: pictures of ``schedule.frames``, in order; some may be missing. A picture need not be valid for longer
    than until the next one is requested, and neither are those that are returned.
    """
    before: tuple[int, ImageBodies] | None = None  # The last detection
    waiting: list[Picture] = []  # Pictures after it, in one gap between scheduled frames
    for frame, image_rgb in images:
        gap = schedule.gap(frame)
        if waiting and schedule.gap(waiting[0][0]) != gap:
            # The picture of the detection after them is missing.
            yield from _between(_opening(before, waiting[0][0], schedule), waiting, None, detector, schedule)
            waiting = []
        if frame != schedule.detected[gap]:
            waiting.append((frame, image_rgb.copy()))
            continue
        bodies = detector.detect(image_rgb)
        yield from _between(_opening(before, frame, schedule), waiting, (frame, bodies), detector, schedule)
        yield frame, image_rgb, bodies
        before, waiting = (frame, bodies), []
    if waiting:
        yield from _between(_opening(before, waiting[0][0], schedule), waiting, None, detector, schedule)


def _opening(
    detection: tuple[int, ImageBodies] | None, frame: int, schedule: DetectionSchedule
) -> tuple[int, ImageBodies] | None:
    """Return the last detection if it opens the gap of a frame; otherwise that detection is missing."""
    is_opening = detection is not None and schedule.gap(detection[0]) == schedule.gap(frame) - 1
    return detection if is_opening else None


def _between(
    before: tuple[int, ImageBodies] | None,
    images: Sequence[Picture],
    after: tuple[int, ImageBodies] | None,
    detector: BodyDetector,
    schedule: DetectionSchedule,
) -> Iterator[NumberedPictureBodies]:
    """Bodies in pictures between two detections; ``None`` stands for a detection that is missing."""
    if not images:
        return
    pairs = None if before is None or after is None else pair_bodies(before[1], after[1])
    if before is not None and after is not None and pairs is not None:
        for frame, image_rgb in images:
            share = schedule.share(before[0], frame, after[0])
            yield frame, image_rgb, interpolate(before[1], after[1], pairs, share)
        return
    middle = len(images) // 2
    frame, image_rgb = images[middle]
    bodies = detector.detect(image_rgb)
    yield from _between(before, images[:middle], (frame, bodies), detector, schedule)
    yield frame, image_rgb, bodies
    yield from _between((frame, bodies), images[middle + 1 :], after, detector, schedule)


def pair_bodies(before: ImageBodies, after: ImageBodies) -> Int[np.ndarray, " n"] | None:
    """Find each body of a detection in the next one.

    Returns the number of each body in ``after``. ``None`` if a body is in one detection alone, or if its joints on
    average, or one that is sure, are elsewhere by more than a tenth of the body's size.
    """
    if len(before.score) != len(after.score):
        return None
    if not len(before.score):
        return np.zeros(0, np.int64)
    score = np.minimum(before.score[:, None], after.score[None])
    distance_px = np.linalg.norm(before.keypoints_px[:, None] - after.keypoints_px[None], axis=-1)
    size_px = np.maximum(_sizes_px(before)[:, None], _sizes_px(after)[None])
    step = np.where(score >= _MIN_SCORE, distance_px, 0.0) / size_px[..., None]
    num_seen = (score >= _MIN_SCORE).sum(-1)
    mean_step = np.where(num_seen >= _MIN_JOINTS, step.sum(-1) / np.maximum(num_seen, 1), np.inf)
    is_fast = ((step > _MAX_STEP) & (score >= _SURE_SCORE)).any(-1)
    rows, pairs = np.arange(len(mean_step)), mean_step.argmin(1)
    is_mutual = mean_step.argmin(0)[pairs] == rows
    is_near = (mean_step[rows, pairs] <= _MAX_STEP) & ~is_fast[rows, pairs]
    return pairs if (is_mutual & is_near).all() else None


def _sizes_px(bodies: ImageBodies) -> Float[np.ndarray, " n"]:
    return np.linalg.norm(bodies.box_px[:, 2:] - bodies.box_px[:, :2], axis=-1)


def interpolate(before: ImageBodies, after: ImageBodies, pairs: Int[np.ndarray, " n"], share: float) -> ImageBodies:
    """Interpolate bodies between two detections.

    Body n of ``before`` is body ``pairs[n]`` of ``after``. ``share`` is the place between them, from 0 to 1. A joint
    that one of them lacks, or that is elsewhere by more than a tenth of the body's size, is missing.
    """
    size_px = np.maximum(_sizes_px(before), _sizes_px(after)[pairs])
    step_px = np.linalg.norm(after.keypoints_px[pairs] - before.keypoints_px, axis=-1)
    is_near = step_px <= _MAX_STEP * size_px[:, None]
    keypoints_px = _mix(before.keypoints_px, after.keypoints_px[pairs], share)
    return ImageBodies(
        read_only(np.where(is_near[..., None], keypoints_px, np.nan)),
        read_only(np.where(is_near, _mix(before.score, after.score[pairs], share), 0.0)),
        read_only(_mix(before.box_px, after.box_px[pairs], share)),
        read_only(_mix(before.center_score, after.center_score[pairs], share)),
    )


def _mix(
    first: Float[np.ndarray, "*shape"], second: Float[np.ndarray, "*shape"], share: float
) -> Float[np.ndarray, "*shape"]:
    return first + share * (second - first)
