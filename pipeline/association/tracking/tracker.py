"""Cross-view tracker: compiled loops over frames, targets started in between.

``TrackerState`` takes frames as they come, ``Tracker`` all frames of a session.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.association.tracking import initialization
from pipeline.association.tracking.kernels import tracking_kernels as kernels
from pipeline.association.tracking.kernels.observation_kernels import keep_used
from pipeline.association.tracking.kernels.state import (
    Frames,
    Limits,
    Outcome,
    Pool,
    RigGeometry,
    make_targets,
    make_workspace,
)
from pipeline.association.tracking.observations import UNASSIGNED, Detections2D
from pipeline.association.tracking.tracking_parameters import TrackingParameters
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.progress import OnShare, ignore
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import center_in_world, projection_matrices
from pipeline.geometry.epipolar import fundamental_matrices
from pipeline.geometry.tracks import triangulate_frames

_FIRST_SLOTS = 16
_FIRST_DETECTIONS = 8
# Most targets at once, tentative and lost targets included. Matching grows with the square of their number.
_MAX_TARGETS = 512
# Frames between two reports of progress; a frame of a hundred people and 512 targets takes a twentieth of a second.
_FRAMES_AT_ONCE = 64


def make_rig(cameras: Sequence[Camera]) -> RigGeometry:
    """Gather the geometry of all cameras in arrays."""
    projections = projection_matrices(cameras)
    return RigGeometry(
        image_from_world=projections,
        world_ray_from_image=np.linalg.inv(projections[:, :, :3]),
        center_m=np.array([center_in_world(camera) for camera in cameras]),
        fundamental=fundamental_matrices(cameras),
    )


def make_frames(
    times: Sequence[FrameTimes],
    bodies: Detections2D,
    ideal_px: Float[np.ndarray, "detections joints 2"],
    min_score: float,
) -> Frames:
    """Sort the frames of all cameras by time; frames of the same time keep the order of the cameras.

    ``times`` are in the order of ``bodies.camera``, and ``ideal_px`` are the undistorted joints; joints with a score
    below ``min_score`` are not used.
    """
    first, last = [], []
    starts = np.searchsorted(bodies.camera, np.arange(len(times) + 1))
    for number, frames in enumerate(times):
        rows = slice(starts[number], starts[number + 1])
        borders = starts[number] + np.searchsorted(bodies.frame[rows], np.arange(len(frames.time_s) + 1))
        first.append(borders[:-1])
        last.append(borders[1:])
    time_s = np.concatenate([frames.time_s for frames in times])
    camera = np.repeat(np.arange(len(times)), [len(frames.time_s) for frames in times])
    in_time = np.argsort(time_s, kind="stable")
    score = large_arrays.empty(bodies.score.shape)
    keep_used(bodies.score, min_score, score)
    return Frames(
        time_s[in_time],
        camera[in_time],
        np.concatenate(first)[in_time],
        np.concatenate(last)[in_time],
        points_px=ideal_px,
        score=score,
        flat_px=ideal_px.reshape(len(ideal_px), 2 * ideal_px.shape[1]),
    )


class TrackerState:
    """State of the tracker between two frames, which gives detections the numbers of targets.

    ``parameters`` come from ``derive_parameters``; ``most_detections`` in a frame are expected, more are taken.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        num_joints: int,
        parameters: TrackingParameters,
        most_detections: int = _FIRST_DETECTIONS,
    ) -> None:
        self._cameras = cameras
        self._num_joints = num_joints
        self._parameters = parameters
        self._limits = Limits(**{name: getattr(parameters, name) for name in Limits._fields})
        self._rig = make_rig(cameras)
        self._targets = make_targets(_FIRST_SLOTS, len(cameras), num_joints, most_detections)
        self._workspace = make_workspace(_FIRST_SLOTS, most_detections)
        self._pool = Pool(
            np.zeros((len(cameras), most_detections), np.int64),
            np.zeros(len(cameras), np.int64),
            np.full(len(cameras), -np.inf),
        )
        self._outcome = Outcome(
            np.full(0, UNASSIGNED), np.full(_FIRST_SLOTS, -1), np.zeros(_FIRST_SLOTS, bool), np.full(1, -np.inf)
        )
        self._num_born = 0

    def advance(
        self,
        frames: Frames,
        identity: Int[np.ndarray, " detections"],
        on_share: OnShare = ignore,
        on_approximate: Callable[[float], object] = ignore,
    ) -> None:
        """Process frames in time order, none before frames of earlier calls.

        ``frames``: frames; the detections that ``carry`` returned are the first rows of their detections. ``identity``:
        output: number of each detection's target; unchanged where a detection belongs to no target. Detections that
        were carried may get a target, too. ``on_share``: called with the completed share of the frames, at least every
        64 frames. ``on_approximate``: called with each time at which new people were not grouped exactly, or exceeded
        the limit of targets.
        """
        event, num_frames = 0, len(frames.time_s)
        self._make_room(int((frames.last - frames.first).max(initial=1)))
        self._outcome = self._outcome._replace(identity=identity)
        while event < num_frames:
            stop = min(event + _FRAMES_AT_ONCE, num_frames)
            some = frames._replace(time_s=frames.time_s[:stop])
            event = kernels.track(
                event, some, self._rig, self._limits, self._targets, self._pool, self._outcome, self._workspace
            )
            if event < stop:
                time_s = float(frames.time_s[event])
                if not self._start_targets(frames, time_s):
                    on_approximate(time_s)
                event += 1
            on_share(event / num_frames)

    def carry(self) -> Int[np.ndarray, " rows"]:
        """Rows of the detections that may start a target with detections of later frames: they must be kept.

        They are unmatched detections of each camera's most recent frame. The next call of ``advance`` finds them in
        this order in the first rows.
        """
        waiting = np.arange(self._pool.rows.shape[1]) < self._pool.num_rows[:, None]
        rows = self._pool.rows[waiting]
        self._pool.rows[waiting] = np.arange(len(rows))
        return rows

    @property
    def num_born(self) -> int:
        """Number of targets, ended ones included unless they were forgotten."""
        return self._num_born

    def states(self) -> np.ndarray:
        """State of the living targets in order of creation; records of ``state.target_dtype``."""
        return self._targets.state[self._targets.order[: self._targets.alive[0]]]

    def final_identities(self) -> Int[np.ndarray, " targets"]:
        """Number of each target after the merge of duplicates; ``UNASSIGNED`` if the target was never confirmed."""
        final = np.arange(self._num_born)
        twins = self._outcome.replaced_by[: self._num_born]
        while (moved := twins[final] >= 0).any():
            final[moved] = twins[final[moved]]
        return np.where(self._outcome.earned[final], final, UNASSIGNED)

    def forget_ended(self) -> Int[np.ndarray, " targets"]:
        """Forget targets that ended, and number the living ones from 0; returns their numbers until now, ascending."""
        slots = self._targets.order[: self._targets.alive[0]]
        former = np.sort(self._targets.state["target_id"][slots])
        self._targets.state["target_id"][slots] = np.searchsorted(former, self._targets.state["target_id"][slots])
        # No living target was merged into another one.
        self._outcome.earned[: len(former)] = self._outcome.earned[former]
        self._outcome.earned[len(former) :] = False
        self._outcome.replaced_by[:] = -1
        self._num_born = len(former)
        return former

    def _start_targets(self, frames: Frames, time_s: float) -> bool:
        """Start targets from the unmatched detections of every camera's most recent frame; return whether exactly."""
        pool = [
            initialization.Unmatched(
                camera, row, float(self._pool.time_s[camera]), _points_px(frames, row), frames.score[row]
            )
            for camera in range(len(self._cameras))
            if time_s - self._pool.time_s[camera] < self._parameters.instant_s
            for row in self._pool.rows[camera, : self._pool.num_rows[camera]].tolist()
        ]
        bodies = []
        groups = initialization.group_unmatched(pool, self._rig.fundamental, self._parameters.alpha_epipolar_px)
        is_exact = groups.is_exact
        for group in groups.people:
            group.sort(key=lambda body: body.time_s)
            xyz_m = self._locate(group)
            if initialization.is_body(xyz_m, initialization.spread_m(self._rig, group, xyz_m), self._parameters):
                bodies.append((group, xyz_m))
        slots = self._lost_slots(time_s)
        returning = initialization.find_returning(
            [xyz_m for _, xyz_m in bodies], self._lost(slots, time_s), self._parameters
        )
        for number, (group, xyz_m) in enumerate(bodies):
            if number in returning:
                slot = self._resume(int(slots[returning[number]]))
            elif self._targets.alive[0] < _MAX_TARGETS:
                slot = self._new_slot()
            else:
                is_exact = False
                continue
            self._place(slot, frames, group, xyz_m, time_s)
        return is_exact

    def _lost_slots(self, time_s: float) -> Int[np.ndarray, " lost"]:
        alive = self._targets.order[: self._targets.alive[0]]
        unseen_s = time_s - self._targets.matched_s[alive].max(-1)
        return alive[self._targets.state["confirmed"][alive] & (unseen_s > self._parameters.velocity_window_s)]

    def _lost(self, slots: Int[np.ndarray, " lost"], time_s: float) -> initialization.Lost:
        state, num_joints = self._targets.state[slots], self._num_joints
        return initialization.Lost(
            state["xyz_m"][..., :num_joints].swapaxes(-1, -2),
            state["velocity_m_s"][..., :num_joints].swapaxes(-1, -2),
            time_s - state["moved_s"],
        )

    def _locate(self, group: Sequence[initialization.Unmatched]) -> Float[np.ndarray, "joints 3"]:
        return triangulate_frames(
            self._rig.image_from_world[[body.camera for body in group]],
            np.array([[body.points_px for body in group]]),
            np.array([[body.score for body in group]]),
        )[0]

    def _resume(self, slot: int) -> int:
        """Restart a lost target: its state is cleared, its number and its confirmation stay."""
        state = self._targets.state
        target_id, num_supported = int(state["target_id"][slot]), int(state["num_supported"][slot])
        kernels.clear(self._targets, slot, target_id)
        state["num_supported"][slot], state["confirmed"][slot] = num_supported, True
        return slot

    def _new_slot(self) -> int:
        self._grow()
        slot = int(self._targets.order[self._targets.alive[0]])
        self._targets.alive[0] += 1
        kernels.clear(self._targets, slot, self._num_born)
        self._num_born += 1
        return slot

    def _place(
        self,
        slot: int,
        frames: Frames,
        group: Sequence[initialization.Unmatched],
        xyz_m: Float[np.ndarray, "joints 3"],
        time_s: float,
    ) -> None:
        """Give a cleared target its first detections, and locate it."""
        targets = self._targets
        targets.state["expected_m"][slot, :, : len(xyz_m)] = xyz_m.T
        for body in group:
            kernels.prepare(targets, frames, body.row, 1, self._rig.world_ray_from_image[body.camera])
            kernels.observe(targets, slot, body.camera, body.time_s, 0, self._rig.image_from_world, self._limits)
            self._outcome.identity[body.row] = targets.state["target_id"][slot]
            self._forget(body)
        kernels.move(targets, slot, time_s, self._limits, self._outcome.earned)

    def _forget(self, claimed: initialization.Unmatched) -> None:
        """Remove a detection from the pool."""
        rows = self._pool.rows[claimed.camera]
        left = [row for row in rows[: self._pool.num_rows[claimed.camera]] if row != claimed.row]
        rows[: len(left)] = left
        self._pool.num_rows[claimed.camera] = len(left)

    def _grow(self) -> None:
        """Double the slots if all are taken, and the identities if all are used."""
        num_slots = len(self._targets.state)
        if self._targets.alive[0] == num_slots:
            self._enlarge(2 * num_slots, len(self._targets.bodies))
        if self._num_born == len(self._outcome.earned):
            self._outcome = self._outcome._replace(
                replaced_by=_doubled(self._outcome.replaced_by, -1), earned=_doubled(self._outcome.earned, False)
            )

    def _make_room(self, most_detections: int) -> None:
        """Make room for frames with more detections than before."""
        if most_detections > len(self._targets.bodies):
            self._enlarge(len(self._targets.state), max(most_detections, 2 * len(self._targets.bodies)))
            rows = np.zeros((len(self._cameras), len(self._targets.bodies)), np.int64)
            rows[:, : self._pool.rows.shape[1]] = self._pool.rows
            self._pool = self._pool._replace(rows=rows)

    def _enlarge(self, num_slots: int, most_detections: int) -> None:
        """Move the targets to larger arrays."""
        num_taken = len(self._targets.state)
        larger = make_targets(num_slots, len(self._cameras), self._num_joints, most_detections)
        larger.alive[0] = self._targets.alive[0]
        larger.order[:num_taken] = self._targets.order
        for old, new in zip(self._targets[2:], larger[2:], strict=True):
            new[: len(old)] = old
        self._targets = larger
        self._workspace = make_workspace(num_slots, most_detections)


class Tracker:
    """Gives every detection of a session the identity of a person.

    ``frames`` come from ``make_frames``, ``parameters`` from ``derive_parameters``.
    """

    def __init__(self, cameras: Sequence[Camera], frames: Frames, parameters: TrackingParameters) -> None:
        self._frames = frames
        self.state = TrackerState(
            cameras, frames.score.shape[1], parameters, int((frames.last - frames.first).max(initial=1))
        )

    def run(
        self, on_share: OnShare = ignore, on_approximate: Callable[[float], object] = ignore
    ) -> Int[np.ndarray, " detections"]:
        """Process all frames in time order.

        See ``TrackerState.advance`` for ``on_share`` and ``on_approximate``. Returns the identity of each detection;
        ``UNASSIGNED`` if it belongs to no target, or to a target that was never confirmed.
        """
        identity = np.full(len(self._frames.score), UNASSIGNED)
        self.state.advance(self._frames, identity, on_share, on_approximate)
        return np.append(self.state.final_identities(), UNASSIGNED)[identity]


def _points_px(frames: Frames, row: int) -> Float[np.ndarray, "joints 2"]:
    """Undistorted joints of a detection, NaN where a joint is not used."""
    return np.where(frames.score[row][:, None] > 0, frames.points_px[row], np.nan)


def _doubled(values: Int[np.ndarray, " n"] | Bool[np.ndarray, " n"], fill: int) -> np.ndarray:
    return np.concatenate([values, np.full_like(values, fill)])
