"""People in the frames of all cameras, by the tracker of whole sessions, one frame after the other."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.association.tracking.kernels.state import Frames
from pipeline.association.tracking.observations import UNASSIGNED
from pipeline.association.tracking.tracker import TrackerState
from pipeline.association.tracking.tracking_parameters import TrackingParameters
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.kernels import make_solver, settle_frame, triangulate_frame
from pipeline.run.live.frames import LiveFrame
from pipeline.run.live.settings import SAME_INSTANT

# Targets, ended ones included, from which on ended targets are forgotten. Noise may start some every second.
_MOST_NUMBERED = 1024
# A camera's frame shows an instant up to so many periods later.
_LONGEST_AGE = 1.5


@dataclass(slots=True, eq=False)
class _Target:
    """Latest detections of a target."""

    seen_s: Float[np.ndarray, " cameras"]  # Time of the camera's latest detection; minus infinity without one
    flat_px: Float[np.ndarray, "cameras coordinates"]  # Its undistorted joints, x and y of each in turn
    score: Float[np.ndarray, "cameras joints"]
    located_m: Float[np.ndarray, "joints 3"]  # Positions at the last instant, NaN where unknown
    number: int = 0  # Number of the person from 1; 0 until the target is confirmed
    # Colours of each camera's latest detection since the last instant
    colours: dict[int, UInt8[np.ndarray, "parts bins"]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A person at an instant: positions, and the observations behind them."""

    number: int  # Number of the person, from 1
    xyz_m: Float[np.ndarray, "joints 3"]  # World positions, NaN where fewer than two cameras see the joint
    flat_px: Float[np.ndarray, "cameras coordinates"]  # Undistorted joints, x and y in turn; NaN without an observation
    score: Float[np.ndarray, "cameras joints"]  # 0 without an observation
    # Colours of the clothes by the cameras' positions, of detections that no earlier instant had
    colours: Mapping[int, UInt8[np.ndarray, "parts bins"]]


class LiveTracker:
    """Numbers of people for detections, and positions of people at instants. ``rate_hz`` is the cameras' rate."""

    def __init__(
        self, cameras: Sequence[Camera], num_joints: int, parameters: TrackingParameters, rate_hz: float
    ) -> None:
        self._parameters, self._rate_hz = parameters, rate_hz
        self._state = TrackerState(cameras, num_joints, parameters)
        self._image_from_world = projection_matrices(cameras)
        self._solver = make_solver(self._image_from_world, parameters.min_score)
        self._frame_s = np.full(len(cameras), -np.inf)  # time of each camera's latest frame
        self._targets: dict[int, _Target] = {}
        self._num_people = 0
        # Detections that may start a target with detections of later frames.
        self._carried_px, self._carried_score = np.empty((0, num_joints, 2)), np.empty((0, num_joints))
        self._carried_camera, self._carried_s = np.empty(0, np.int64), np.empty(0)
        self._carried_colours: list[UInt8[np.ndarray, "parts bins"] | None] = []

    @property
    def numbers(self) -> frozenset[int]:
        """Numbers of the people who are followed, in sight or hidden for a short time."""
        return frozenset(target.number for target in self._targets.values() if target.number)

    def num_kept(self) -> int:
        """Number of targets and detections that are kept."""
        return len(self._targets) + len(self._carried_score)

    def advance(self, frames: Sequence[LiveFrame]) -> Int[np.ndarray, " detections"]:
        """Process frames in time order, none before the frames of earlier calls.

        Returns the number of the person in each of their detections as far as it is known by now; ``UNASSIGNED`` for
        detections of targets that are not confirmed, some of which are confirmed by later frames.
        """
        if not frames:
            return np.empty(0, np.int64)
        num_carried = len(self._carried_score)
        counts = [len(frame.score) for frame in frames]
        borders = num_carried + np.cumsum([0, *counts])
        points_px = np.concatenate([self._carried_px, *(frame.ideal_px for frame in frames)])
        score = np.concatenate([self._carried_score, *(frame.score for frame in frames)])
        time_s, camera = np.array([frame.time_s for frame in frames]), np.array([frame.camera for frame in frames])
        row_camera = np.concatenate([self._carried_camera, np.repeat(camera, counts)])
        row_s = np.concatenate([self._carried_s, np.repeat(time_s, counts)])
        colours = [*self._carried_colours, *(colour for frame in frames for colour in frame.colours)]
        identity = np.full(len(score), UNASSIGNED)
        used = np.where(score >= self._parameters.min_score, score, 0.0)
        flat_px = points_px.reshape(len(points_px), 2 * points_px.shape[1])
        self._state.advance(
            Frames(time_s, camera, borders[:-1].copy(), borders[1:].copy(), points_px, used, flat_px), identity
        )
        self._frame_s[camera] = time_s
        for row in np.flatnonzero(identity != UNASSIGNED).tolist():
            self._see(
                int(identity[row]), int(row_camera[row]), float(row_s[row]), flat_px[row], score[row], colours[row]
            )
        self._follow_targets()
        number = [self._targets[target].number if target in self._targets else 0 for target in identity.tolist()]
        if self._state.num_born > _MOST_NUMBERED:
            former = self._state.forget_ended().tolist()
            self._targets = {new: self._targets[old] for new, old in enumerate(former)}
        carried = self._state.carry()
        self._carried_px, self._carried_score = points_px[carried], score[carried]
        self._carried_camera, self._carried_s = row_camera[carried], row_s[carried]
        self._carried_colours = [colours[row] for row in carried.tolist()]
        return np.array([person or UNASSIGNED for person in number[num_carried:]], np.int64)

    def _see(
        self,
        target: int,
        camera: int,
        time_s: float,
        flat_px: Float[np.ndarray, " coordinates"],
        score: Float[np.ndarray, " joints"],
        colour: UInt8[np.ndarray, "parts bins"] | None,
    ) -> None:
        """Keep a detection as the latest of its target and camera."""
        if target not in self._targets:
            shape = len(self._frame_s), len(score)
            self._targets[target] = _Target(
                np.full(shape[0], -np.inf), np.full((shape[0], 2 * shape[1]), np.nan), np.zeros(shape),
                np.full((shape[1], 3), np.nan),
            )  # fmt: skip
        seen = self._targets[target]
        if time_s >= seen.seen_s[camera]:
            seen.seen_s[camera], seen.flat_px[camera], seen.score[camera] = time_s, flat_px, score
            if colour is not None:
                seen.colours[camera] = colour

    def _follow_targets(self) -> None:
        """Drop targets that ended, and number those that were confirmed."""
        states = self._state.states()
        living = states["target_id"].tolist()
        self._targets = {target: self._targets[target] for target in living}
        for target, is_confirmed in zip(living, states["confirmed"].tolist(), strict=True):
            if is_confirmed and not self._targets[target].number:
                self._num_people += 1
                self._targets[target].number = self._num_people

    def people_at(self, time_s: float) -> Iterator[Sighting]:
        """People that a camera sees at an instant, in order of their numbers; no frame may be behind it.

        Frames of a camera that are before the instant are moved to it by the speed of the person.
        """
        states = {int(state["target_id"]): state for state in self._state.states()}
        confirmed = [(seen.number, target) for target, seen in self._targets.items() if seen.number]
        for number, target in sorted(confirmed):
            seen = self._targets[target]
            age_s = time_s - seen.seen_s
            is_shown = (seen.seen_s == self._frame_s) & (age_s < _LONGEST_AGE / self._rate_hz)
            if is_shown.any():
                flat_px = np.where(is_shown[:, None], seen.flat_px, np.nan)
                decay = np.where(age_s > SAME_INSTANT / self._rate_hz, np.exp(-self._parameters.lambda_t_hz * age_s), 1)
                score = np.where(is_shown[:, None], seen.score * decay[:, None], 0.0)
                for camera in np.flatnonzero(is_shown & (age_s > SAME_INSTANT / self._rate_hz)).tolist():
                    flat_px[camera] += self._moved_px(camera, states[target], time_s, float(age_s[camera]))
                colours, seen.colours = seen.colours, {}
                yield Sighting(number, self._locate(seen, flat_px, score), flat_px, score, colours)
            else:
                seen.located_m[:] = np.nan

    def _moved_px(self, camera: int, state: np.void, time_s: float, age_s: float) -> Float[np.ndarray, " coordinates"]:
        """Movement of a target's joints in a camera's picture in the time before an instant; 0 where it is unknown."""
        num_joints = self._carried_score.shape[1]
        velocity_m_s, updated_s = state["velocity_m_s"][:, :num_joints], state["updated_s"][:num_joints]
        now_m = state["xyz_m"][:, :num_joints] + np.where(np.isfinite(updated_s), time_s - updated_s, 0) * velocity_m_s
        matrix = self._image_from_world[camera]
        ends_px = []
        for xyz_m in (now_m, now_m - age_s * velocity_m_s):
            homogeneous = matrix[:, :3] @ xyz_m + matrix[:, 3:]
            ends_px.append(homogeneous[:2] / homogeneous[2])
        return np.nan_to_num(ends_px[0] - ends_px[1]).T.ravel()

    def _locate(
        self,
        seen: _Target,
        flat_px: Float[np.ndarray, "cameras coordinates"],
        score: Float[np.ndarray, "cameras joints"],
    ) -> Float[np.ndarray, "joints 3"]:
        """Triangulate a person as ``geometry.tracks.triangulate_frames``; the last positions are the guess."""
        xyz_m, disputed = np.empty(seen.located_m.shape), np.empty(len(seen.located_m), bool)
        triangulate_frame(self._solver, flat_px, score, xyz_m, disputed)
        apart_m = np.linalg.norm(seen.located_m - xyz_m, axis=-1)
        disputed &= apart_m > self._solver.disputed_m
        if disputed.any():
            settle_frame(self._solver, flat_px, score, disputed, seen.located_m, xyz_m)
        seen.located_m = xyz_m
        return xyz_m.copy()
