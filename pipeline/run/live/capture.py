"""A live capture in progress: frames of cameras in, people at instants out."""

import math
from collections.abc import Iterator, Sequence
from operator import attrgetter

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import ArrayLike

from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import MARKED_AT_CENTERS, JointOffsets, JointSet
from pipeline.core.problems.request_codes import OUT_OF_RANGE, VALUE_NOT_ALLOWED, WRONG_LENGTH
from pipeline.detection.appearance import NUM_BINS, PARTS
from pipeline.geometry.camera import center_in_world, projection_matrices
from pipeline.run.live.frames import FrameQueue, LiveFrame, make_frame
from pipeline.run.live.identities import Identities
from pipeline.run.live.packets import MAX_PX
from pipeline.run.live.records import LiveCounts, LiveInstant, LivePerson
from pipeline.run.live.settings import LiveSettings
from pipeline.run.live.skeleton import LiveBody
from pipeline.run.live.tracking import LiveTracker, Sighting

_MOST_BODIES = 128
# Times that keep the instants apart: seconds since 1970, with room to spare.
_LONGEST_S = 1e11
# Instants without frames are left out, except those in a pause up to this long.
_LONGEST_PAUSE_S = 1.0
# Bones are learnt in steps at instants that are this far apart, so that several people's bones delay no instant: a
# step takes about as long as a pose. Less than the distance of two instants at 60 Hz, rounded.
_LEARNING_STEP_S = 0.03


class LiveCapture:
    """Live capture in progress.

    The identities are those that ``tracking`` gives to the same frames of a finished session, as far as they don't need
    later frames. Memory does not grow with the length of the capture.

    Parameters
    ----------
    cameras
        Cameras with different names, at least two.
    joints
        Joint set of the detector.
    settings
        Rates and times.
    offsets
        Offsets of the detector's marks from the joints' centres, like ``joint_centers`` of a job.

    Raises
    ------
    InputError
        If there are fewer than two cameras, or two of the same name.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> capture = multicap.LiveCapture(session.cameras, session.joints, multicap.LiveSettings(25.0))
    >>> frames = multicap.recorded_frames(session.cameras, session.times, session.detections)
    >>> instants = [instant for frame in frames for instant in capture.push(*frame)] + capture.flush()
    >>> len(instants) > 5
    True
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        joints: JointSet,
        settings: LiveSettings,
        offsets: JointOffsets = MARKED_AT_CENTERS,
    ) -> None:
        self._offsets = offsets
        self._names = {camera.name: number for number, camera in enumerate(cameras)}
        if len(self._names) < max(2, len(cameras)):
            message = "A live capture needs at least two cameras, with different names."
            raise InputError([Problem(VALUE_NOT_ALLOWED, message, field="cameras")])
        self._cameras, self._joints, self._settings = tuple(cameras), joints, settings
        self._queue = FrameQueue(len(cameras), settings)
        rate_hz = settings.frame_rate_hz
        self._tracker = LiveTracker(cameras, len(joints.names), derive_parameters(cameras, rate_hz), rate_hz)
        self._center_m = np.array([center_in_world(camera) for camera in cameras])
        self._ray_from_image = np.linalg.inv(projection_matrices(cameras)[:, :, :3])
        self._bodies: dict[int, LiveBody] = {}
        bodies = [np.array(length_m) for length_m in settings.bodies]
        self._identities = Identities(joints, len(cameras), bodies, offsets)
        # Time of the last step of learning a person's bones
        self._learnt_s = -math.inf
        self._start_s: float | None = None
        self._num_instants = 0

    def push(
        self,
        camera: int | str,
        time_s: float,
        points_px: Float[np.ndarray, "people joints 2"],
        score: Float[np.ndarray, "people joints"],
        colour: UInt8[np.ndarray, "people parts bins"] | None = None,
    ) -> list[LiveInstant]:
        """Take a frame of a camera; return the instants that became final by it, in time order.

        - ``camera``: position or name of the camera.
        - ``time_s``: time of the frame on the clock that all cameras share.
        - ``points_px``: joints of each body in pixels of the full image (distorted, as seen), NaN where a joint was not
          found. No body: the frame is empty.
        - ``score``: the detector's confidence in each joint, 0 to 1.
        - ``colour``: colours of the clothes of each body, as ``detect.appearance`` measures them in the picture;
          ``None``: they were not measured.
        - Raises ``InputError`` if the camera is unknown, or a value is not allowed; the capture continues without the
          frame.
        """
        number = self._names.get(camera, -1) if isinstance(camera, str) else camera
        points_px, score = _as_numbers(points_px), _as_numbers(score)
        if problems := tuple(self._problems(number, time_s, points_px, score, colour)):
            raise InputError(problems)
        self._queue.add(make_frame(self._cameras[number], number, float(time_s), points_px, score, colour))
        return self._process(self._queue.release())

    def flush(self) -> list[LiveInstant]:
        """Process the frames that wait; return the instants that became final."""
        return self._process(self._queue.release_all())

    @property
    def counts(self) -> LiveCounts:
        """Numbers of frames so far."""
        return self._queue.counts

    @property
    def num_kept(self) -> int:
        """Number of frames, detections and people that are kept; it does not grow with the length of the capture."""
        of_bodies = sum(1 + body.num_kept for body in self._bodies.values())
        return len(self._queue) + self._tracker.num_kept() + of_bodies + len(self._identities)

    def _process(self, frames: Sequence[LiveFrame]) -> list[LiveInstant]:
        rate_hz, instants, num_done = self._settings.instants_hz, [], 0
        within_s = self._settings.same_instant_s / 2
        if self._start_s is None and frames:
            self._start_s = frames[0].time_s
        while self._start_s is not None:
            time_s = self._start_s + self._num_instants / rate_hz
            if time_s + within_s > self._queue.settled_s:
                break
            upcoming_s = frames[num_done].time_s if num_done < len(frames) else self._queue.settled_s
            if upcoming_s - time_s > _LONGEST_PAUSE_S:
                self._num_instants = math.ceil((upcoming_s - _LONGEST_PAUSE_S - self._start_s) * rate_hz)
                continue
            first = num_done
            while num_done < len(frames) and frames[num_done].time_s <= time_s + within_s:
                num_done += 1
            self._tracker.advance(frames[first:num_done])
            instants.append(self._instant(time_s))
            self._num_instants += 1
        self._tracker.advance(frames[num_done:])
        return instants

    def _instant(self, time_s: float) -> LiveInstant:
        self._bodies = {number: body for number, body in self._bodies.items() if number in self._tracker.numbers}
        self._identities.keep(self._tracker.numbers)
        people = sorted((self._person(time_s, seen) for seen in self._tracker.people_at(time_s)), key=attrgetter("id"))
        return LiveInstant(time_s, tuple(people), max(0.0, self._queue.newest_s - time_s))

    def _person(self, time_s: float, seen: Sighting) -> LivePerson:
        """A person with the skeleton, once bones are learnt."""
        if seen.number not in self._bodies:
            rate_hz, learn_s = self._settings.instants_hz, self._settings.learn_s
            self._bodies[seen.number] = LiveBody(self._joints, self._center_m, rate_hz, learn_s, self._offsets)
        num_cameras, num_joints = seen.score.shape
        points_px = seen.flat_px.reshape(num_cameras, num_joints, 2)
        homogeneous = np.concatenate([points_px, np.ones((num_cameras, num_joints, 1))], axis=-1)
        rays = homogeneous @ self._ray_from_image.swapaxes(-1, -2)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        body = self._bodies[seen.number]
        known = self._identities.see(seen.number, time_s, seen.xyz_m, seen.colours)
        if known is not None and body.bones is None:
            body.recall(known.length_m, known.bones)
        followed = body.follow(time_s, seen.xyz_m, rays.swapaxes(0, 1), seen.score.T)
        if body.is_learning and time_s - self._learnt_s >= _LEARNING_STEP_S:
            self._learnt_s = time_s
            body.learn_a_step()
            if body.bones is not None:
                self._identities.learn(seen.number, body.bones)
        number = self._identities.person_number(seen.number)
        if followed is None:
            return LivePerson(number, seen.xyz_m, None)
        skeleton, xyz_m = followed
        return LivePerson(number, np.where(np.isfinite(xyz_m), xyz_m, seen.xyz_m), skeleton)

    def _problems(
        self, number: int, time_s: float, points_px: np.ndarray, score: np.ndarray, colour: np.ndarray | None
    ) -> Iterator[Problem]:
        """Find everything that is wrong with a frame."""
        if not (isinstance(number, int | np.integer) and 0 <= number < len(self._cameras)):
            message = f"camera must be one of {', '.join(self._names)}, or its position."
            yield Problem(VALUE_NOT_ALLOWED, message, field="camera")
        if not (isinstance(time_s, int | float | np.number) and abs(time_s) <= _LONGEST_S):
            yield Problem(OUT_OF_RANGE, "time_s must be a finite number of seconds.", field="time_s")
        num_joints = len(self._joints.names)
        num_people = len(points_px) if points_px.ndim else 0
        if points_px.shape != (num_people, num_joints, 2) or score.shape != (num_people, num_joints):
            message = (
                f"points_px must be of shape (people, {num_joints}, 2), and score of shape (people, {num_joints})."
            )
            yield Problem(WRONG_LENGTH, message, field="points_px")
        else:
            if not np.all((score >= 0) & (score <= 1)):
                yield Problem(OUT_OF_RANGE, "score must be from 0 to 1.", field="score")
            if np.any(np.abs(points_px) > MAX_PX):
                message = f"points_px must be within {MAX_PX:,.0f} pixels, NaN where a joint was not found."
                yield Problem(OUT_OF_RANGE, message, field="points_px")
        if num_people > _MOST_BODIES:
            message = f"points_px must have at most {_MOST_BODIES} bodies."
            yield Problem(WRONG_LENGTH, message, field="points_px")
        form = (num_people, len(PARTS), NUM_BINS), np.dtype(np.uint8)
        if colour is not None and not (isinstance(colour, np.ndarray) and (colour.shape, colour.dtype) == form):
            message = f"colour must be bytes of shape (people, {len(PARTS)}, {NUM_BINS})."
            yield Problem(WRONG_LENGTH, message, field="colour")


def _as_numbers(values: ArrayLike) -> np.ndarray:
    """Array of numbers; what is none has no axes, so that its shape is wrong."""
    try:
        return np.asarray(values, np.float64)
    except (TypeError, ValueError):
        return np.array(np.nan)
