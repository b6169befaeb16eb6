"""People whom the cameras see at a few instants of a session."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.joints import FINGER_JOINTS, JointSet
from pipeline.geometry.undistortion import undistort_px

NUM_INSTANTS = 12
"""Number of instants at which people are looked at: enough for medians, few enough for a network on a processor."""

# Within less time people hardly move, and what a detector gets wrong it gets wrong again.
_INDEPENDENT_S = 0.25
# Joints with lower scores are guesses, and fewer joints are no body.
_MIN_SCORE, _MIN_JOINTS = 0.3, 6

Points = Float[np.ndarray, "_ _ 2"]
"""Joints of people, (people, joints, 2), in pixels; NaN where a joint was not seen."""


@dataclass(frozen=True, slots=True)
class SimultaneousPeople:
    """People at the same instants in all cameras."""

    # Joints of the people by camera, then by instant; ``None`` where the camera took no frame. Pixels of the picture as
    # the camera took it.
    points_px: tuple[tuple[Points | None, ...], ...]
    joints: JointSet  # Joints of the people, without fingers
    time_s: tuple[float, ...]  # Times of the instants, ascending

    def num_people(self, camera: int) -> int:
        """Number of people whom a camera sees, at all instants together."""
        return sum(len(people) for people in self.points_px[camera] if people is not None)

    def moved(self, camera: int, move: Callable[[Points], Points]) -> "SimultaneousPeople":
        """Sightings after the points of a camera were moved."""
        own = tuple(None if people is None else move(people) for people in self.points_px[camera])
        return replace(self, points_px=(*self.points_px[:camera], own, *self.points_px[camera + 1 :]))

    def num_independent(self, instants: Iterable[int]) -> int:
        """Number of instants, given by their places, that tell something new: those a quarter of a second apart."""
        number, last_s = 0, -np.inf
        for instant in sorted(instants):
            if self.time_s[instant] - last_s >= _INDEPENDENT_S:
                number, last_s = number + 1, self.time_s[instant]
        return number


def choose_instants(stretches: Sequence[range], number: int = NUM_INSTANTS) -> list[int]:
    """Output frames in the middle of equal parts of the recorded frames, ascending.

    They do not depend on how the frames are cut into ranges.
    """
    total = sum(map(len, stretches))
    places = sorted({int((part + 0.5) * total / number) for part in range(number)}) if total else []
    frames: list[int] = []
    before = 0
    for stretch in stretches:
        frames += [stretch[place - before] for place in places if before <= place < before + len(stretch)]
        before += len(stretch)
    return frames


def frames_at(times: FrameTimes, timebase: Timebase, instants: Sequence[int]) -> list[int | None]:
    """Frames of a camera that were taken at output frames; ``None`` where the camera took none."""
    frames: list[int | None] = []
    for instant in instants:
        time_s = timebase.time_s(instant)
        number = int(np.argmin(np.abs(times.time_s - time_s))) if len(times.time_s) else 0
        is_near = len(times.time_s) and abs(times.time_s[number] - time_s) <= 1.0 / timebase.frame_rate_hz
        frames.append(number if is_near else None)
    return frames


def sightings_of(
    cameras: Sequence[Camera],
    detections: Mapping[str, Detections],
    frames: Mapping[str, Sequence[int | None]],
    joints: JointSet,
    time_s: Sequence[float],
) -> SimultaneousPeople:
    """Select the people in frames of each camera.

    Detections of other frames, and fingers, are left out; ``frames`` are those of each camera at the instants, see
    ``frames_at``, and ``time_s`` are the times of the instants.
    """
    kept = [number for number, name in enumerate(joints.names) if name not in FINGER_JOINTS]
    names = tuple(joints.names[number] for number in kept)
    bones = tuple(bone for bone in joints.bones if FINGER_JOINTS.isdisjoint(bone))
    return SimultaneousPeople(
        tuple(
            tuple(
                None if frame is None else _people(detections[camera.name], frame, kept)
                for frame in frames[camera.name]
            )
            for camera in cameras
        ),
        JointSet(names, bones),
        tuple(time_s),
    )


def _people(detections: Detections, frame: int, kept: Sequence[int]) -> Points:
    rows = np.flatnonzero(detections.frame == frame)
    points_px = detections.keypoints_px[rows][:, kept]
    points_px = np.where(detections.score[rows][:, kept, None] >= _MIN_SCORE, points_px, np.nan)
    return np.asarray(points_px[np.isfinite(points_px[..., 0]).sum(-1) >= _MIN_JOINTS], np.float64)


def ideal_px(camera: Camera, of_camera: Sequence[Points | None]) -> list[Points | None]:
    """Undistort the people of a camera at all instants."""
    return [people if people is None or not len(people) else undistort_px(camera, people) for people in of_camera]
