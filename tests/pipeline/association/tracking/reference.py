"""Cross-view tracker in plain NumPy, close to the paper (Chen et al. 2020, algorithm 1) and slow.

Each frame comes from one camera at its own time: no synchronisation is assumed. The frame's detections are matched to
targets in 3D space. Unmatched detections start new targets together with those of the other cameras' most recent
frames. Affinities (eq. 1-5) are means over shared joints, where the paper uses sums: signs and the order within a
detection are the same, and a half-hidden body is not penalised. Tests compare the compiled tracker
(``pipeline.association.tracking.kernels``) with this module.

The compiled tracker skips pairs of target and detection that are too far apart for a positive affinity
(``pruning_kernels``). Only pairs with a positive affinity are ever matched, so skipping them changes no result.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from pipeline.association.tracking.initialization import (
    Lost,
    Unmatched,
    assign,
    find_returning,
    group_unmatched,
    is_body,
    mean_over_joints,
    ray_distance_m,
    spread_m,
)
from pipeline.association.tracking.kernels.state import NUM_RECENT, Frames, RigGeometry
from pipeline.association.tracking.observations import UNASSIGNED
from pipeline.association.tracking.tracking_parameters import TrackingParameters
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import rays_in_world
from pipeline.geometry.triangulation import plane_rows, triangulate, triangulate_robust


def predict(
    xyz_m: Float[np.ndarray, "*batch joints 3"],
    velocity_m_s: Float[np.ndarray, "*batch joints 3"],
    age_s: Float[np.ndarray, "*batch joints"],
    max_extrapolation_s: float,
) -> Float[np.ndarray, "*batch joints 3"]:
    """Predict positions by linear motion (eq. 5); predictions stand still after ``max_extrapolation_s``."""
    return xyz_m + velocity_m_s * np.minimum(age_s, max_extrapolation_s)[..., None]


def correspondence_2d(
    points_px: Float[np.ndarray, "detections joints 2"],
    last_px: Float[np.ndarray, "targets joints 2"],
    gap_s: Float[np.ndarray, " targets"],
    parameters: TrackingParameters,
) -> Float[np.ndarray, "targets detections joints"]:
    """2D correspondence A2D of detections with the targets' last match in the same camera (eq. 2).

    Pixels are undistorted, NaN where a joint is unseen; ``gap_s`` is the time since each target's last match in this
    camera. A2D is NaN where the target or the detection lacks the joint.
    """
    moved_px = np.linalg.norm(points_px[None] - last_px[:, None], axis=-1)
    allowed_px = parameters.alpha_2d_px_s * gap_s[:, None, None]
    decay = np.exp(-parameters.lambda_a_hz * gap_s)[:, None, None]
    return parameters.weight_2d * np.maximum(1 - moved_px / allowed_px, -1.0) * decay


def correspondence_3d(
    rays: Float[np.ndarray, "detections joints 3"],
    center_m: Float[np.ndarray, " 3"],
    predicted_m: Float[np.ndarray, "targets joints 3"],
    age_s: Float[np.ndarray, "targets joints"],
    parameters: TrackingParameters,
) -> Float[np.ndarray, "targets detections joints"]:
    """3D correspondence A3D of predicted joints and viewing rays (eq. 4).

    Parameters
    ----------
    rays, center_m
        Unit rays of the detections' joints in the world, NaN where a joint is unseen, and the camera's centre.
    predicted_m, age_s
        Predicted joints, NaN where unknown, and the time since they were located.

    Returns
    -------
        A3D, NaN where the target or the detection lacks the joint.
    """
    targets, detections = np.broadcast_arrays(predicted_m[:, None], rays[None])
    distance_m = ray_distance_m(targets, center_m, detections)
    decay = np.exp(-parameters.lambda_a_hz * age_s)[:, None]
    return parameters.weight_3d * np.maximum(1 - distance_m / parameters.alpha_3d_m, -1.0) * decay


def affinity(
    terms_2d: Float[np.ndarray, "targets detections joints"], terms_3d: Float[np.ndarray, "targets detections joints"]
) -> Float[np.ndarray, "targets detections"]:
    """Affinity A of targets and detections (eq. 1): mean over shared joints of A2D + A3D.

    It is ``-inf`` for a pair that shares fewer than three joints.
    """
    shared = np.isfinite(terms_3d)
    total = np.where(shared, terms_3d, 0.0) + np.where(shared & np.isfinite(terms_2d), terms_2d, 0.0)
    return mean_over_joints(total, shared)


@dataclass(slots=True, eq=False)
class Target:
    """State of a tracked person (section 3.2).

    Parameters
    ----------
    target_id
        Number from 0, in order of creation.
    xyz_m, updated_s
        Last position of each joint (NaN before the first) and its time t'.
    last_px, weight, matched_s
        Last match of the target in each camera: undistorted joints (NaN where unseen), factors of their rows, and time
        t'' (-inf before the first match).
    velocity_m_s, is_fitted
        Velocity of each joint, 0 while unknown, and whether it includes the newest position.
    recent, recent_since_s
        Times and positions behind the velocity, and the time at which the newest entry was created.
    moved_s
        Time at which a joint was last located.
    supported_s, num_supported, confirmed
        Last instant at which two cameras saw the target together, number of such instants, and whether they confirm
        the target.
    """

    target_id: int
    xyz_m: Float[np.ndarray, "joints 3"]
    updated_s: Float[np.ndarray, " joints"]
    velocity_m_s: Float[np.ndarray, "joints 3"]
    last_px: Float[np.ndarray, "cameras joints 2"]
    weight: Float[np.ndarray, "cameras joints"]
    matched_s: Float[np.ndarray, " cameras"]
    recent: list[tuple[float, Float[np.ndarray, "joints 3"]]] = field(default_factory=list)
    recent_since_s: float = -np.inf
    is_fitted: bool = True
    moved_s: float = -np.inf
    supported_s: float = -np.inf
    num_supported: int = 0
    confirmed: bool = False

    @classmethod
    def empty(cls, target_id: int, num_cameras: int, num_joints: int) -> "Target":
        """Create a target without observations."""
        return cls(
            target_id=target_id,
            xyz_m=np.full((num_joints, 3), np.nan),
            updated_s=np.full(num_joints, -np.inf),
            velocity_m_s=np.zeros((num_joints, 3)),
            last_px=np.full((num_cameras, num_joints, 2), np.nan),
            weight=np.zeros((num_cameras, num_joints)),
            matched_s=np.full(num_cameras, -np.inf),
        )

    def expect(self, time_s: float, parameters: TrackingParameters) -> Float[np.ndarray, "joints 3"]:
        """Predict the joints' world positions at a time (eq. 5), NaN where a joint was never located."""
        if not self.is_fitted and time_s > self.moved_s:
            self._fit_velocity(parameters.velocity_window_s)
        return predict(self.xyz_m, self.velocity_m_s, time_s - self.updated_s, parameters.max_extrapolation_s)

    def _fit_velocity(self, window_s: float) -> None:
        """Fit velocities to the recent positions by linear least squares (eq. 5).

        A joint with fewer than three positions has velocity 0: two positions would turn noise into speed.
        """
        since_s = np.array([at_s for at_s, _ in self.recent]) - self.recent[-1][0]
        positions_m = np.array([xyz_m for _, xyz_m in self.recent])
        known = np.isfinite(positions_m[..., 0]) & (since_s >= -window_s)[:, None]
        count = known.sum(0)
        mean_s = (known * since_s[:, None]).sum(0) / np.maximum(count, 1)
        centred_s = np.where(known, since_s[:, None] - mean_s, 0.0)
        spread = (centred_s**2).sum(0)
        slope = np.einsum("nj,nja->ja", centred_s, np.where(known[..., None], positions_m, 0.0))
        usable = (count >= 3) & (spread > 0)
        self.velocity_m_s = np.where(usable[:, None], slope / np.where(usable, spread, 1.0)[:, None], 0.0)
        self.is_fitted = True

    def observe(
        self,
        detection: Unmatched,
        expected_m: Float[np.ndarray, "joints 3"],
        image_from_world: Float[np.ndarray, "cameras 3 4"],
        parameters: TrackingParameters,
    ) -> None:
        """Store a matched detection as the last match of its camera.

        The weight of a joint is the detector's confidence times the root of ``a^2 / (a^2 + d^2)``, with a the
        parameter ``alpha_3d_m`` and d the distance of the ray to the expected position.
        """
        rows = plane_rows(image_from_world[detection.camera][None], detection.points_px[None])[0]
        distance2_m2 = (((rows[..., :3] @ expected_m[..., None])[..., 0] + rows[..., 3]) ** 2).sum(-1)
        doubt = parameters.alpha_3d_m**2 / (parameters.alpha_3d_m**2 + distance2_m2)
        self.last_px[detection.camera] = detection.points_px
        self.weight[detection.camera] = detection.score * np.sqrt(np.where(np.isnan(doubt), 1.0, doubt))
        self.matched_s[detection.camera] = detection.time_s

    def move(
        self, time_s: float, image_from_world: Float[np.ndarray, "cameras 3 4"], parameters: TrackingParameters
    ) -> None:
        """Triangulate incrementally from the last match of every camera (eq. 6-11)."""
        age_s = time_s - self.matched_s
        fresh = age_s < parameters.velocity_window_s
        penalty = np.where(fresh, np.exp(-parameters.lambda_t_hz * np.where(fresh, age_s, 0.0)), 0.0)
        xyz_m = triangulate(image_from_world, self.last_px, penalty[:, None] * self.weight)
        is_located = np.isfinite(xyz_m[:, 0])
        self.xyz_m = np.where(is_located[:, None], xyz_m, self.xyz_m)
        self.updated_s = np.where(is_located, time_s, self.updated_s)
        self.moved_s = time_s if is_located.any() else self.moved_s
        self.is_fitted = False
        spacing_s = parameters.velocity_window_s / (NUM_RECENT - 1)
        if self.recent and time_s - self.recent_since_s < spacing_s:
            self.recent.pop()
        else:
            self.recent_since_s = time_s
        self.recent = [*self.recent, (time_s, xyz_m)][-NUM_RECENT:]
        if time_s > self.supported_s and np.sum(age_s < parameters.instant_s) >= 2:
            self.supported_s = time_s
            self.num_supported += 1
            self.confirmed |= self.num_supported >= parameters.confirm_instants


class ReferenceTracker:
    """Assignment of detections to people, one frame of one camera at a time; see ``tracker.ReferenceTracker``."""

    def __init__(
        self, cameras: Sequence[Camera], rig: RigGeometry, frames: Frames, parameters: TrackingParameters
    ) -> None:
        self._cameras = cameras
        self._rig = rig
        self._frames = frames
        self._parameters = parameters
        self._unmatched: list[list[Unmatched]] = [[] for _ in cameras]
        self._replaced: dict[int, int] = {}
        self._earned: set[int] = set()
        self._num_born = 0
        self._identity = np.full(len(frames.score), UNASSIGNED)
        self.targets: list[Target] = []

    def run(self) -> Int[np.ndarray, " detections"]:
        """Process all frames in time order.

        Returns the identity of each detection; ``UNASSIGNED`` if it belongs to no target, or to a target that was never
        confirmed.
        """
        merged_s = -np.inf
        for time_s, camera, first, last in zip(*(array.tolist() for array in self._frames[:4]), strict=True):
            if time_s > merged_s:
                self._merge_duplicates(time_s)
                self._bury(time_s)
                merged_s = time_s
            self._step(camera, time_s, range(first, last))
        return np.array([self._final(identity) for identity in self._identity.tolist()], int)

    def _final(self, identity: int) -> int:
        while identity in self._replaced:
            identity = self._replaced[identity]
        return identity if identity in self._earned else UNASSIGNED

    def _step(self, camera: int, time_s: float, rows: range) -> None:
        bodies = [
            Unmatched(
                camera,
                row,
                time_s,
                np.where(self._frames.score[row][:, None] > 0, self._frames.points_px[row], np.nan),
                self._frames.score[row],
            )
            for row in rows
        ]
        expected_m = [target.expect(time_s, self._parameters) for target in self.targets]
        matched = self._match(camera, time_s, bodies, expected_m)
        for i, j in matched:
            self._identity[bodies[j].row] = self.targets[i].target_id
            self.targets[i].observe(bodies[j], expected_m[i], self._rig.image_from_world, self._parameters)
            self._move(self.targets[i], time_s)
        taken = {j for _, j in matched}
        self._unmatched[camera] = [body for j, body in enumerate(bodies) if j not in taken]
        if self._unmatched[camera]:
            self._start_targets(time_s)

    def _move(self, target: Target, time_s: float) -> None:
        target.move(time_s, self._rig.image_from_world, self._parameters)
        if target.confirmed:
            self._earned.add(target.target_id)

    def _match(
        self,
        camera: int,
        time_s: float,
        bodies: Sequence[Unmatched],
        expected_m: Sequence[Float[np.ndarray, "joints 3"]],
    ) -> list[tuple[int, int]]:
        """Match targets and detections by the affinity of eq. 1, confirmed targets before tentative ones."""
        if not self.targets or not bodies:
            return []
        points_px = np.array([body.points_px for body in bodies])
        gap_s = np.array([time_s - target.matched_s[camera] for target in self.targets])
        age_s = np.array([time_s - target.updated_s for target in self.targets])
        affinities = affinity(
            correspondence_2d(
                points_px, np.array([target.last_px[camera] for target in self.targets]), gap_s, self._parameters
            ),
            correspondence_3d(
                rays_in_world(self._cameras[camera], points_px),
                self._rig.center_m[camera],
                np.array(expected_m),
                age_s,
                self._parameters,
            ),
        )
        pairs: list[tuple[int, int]] = []
        free = np.ones(len(bodies), bool)
        for confirmed in (True, False):
            rows = np.flatnonzero([target.confirmed == confirmed for target in self.targets])
            columns = np.flatnonzero(free)
            chosen = assign(affinities[np.ix_(rows, columns)])
            pairs.extend((int(rows[i]), int(columns[j])) for i, j in chosen)
            free[[int(columns[j]) for _, j in chosen]] = False
        return sorted(pairs)

    def _start_targets(self, time_s: float) -> None:
        """Start targets from the unmatched detections of every camera's most recent frame."""
        pool = [body for view in self._unmatched for body in view if time_s - body.time_s < self._parameters.instant_s]
        bodies = []
        for group in group_unmatched(pool, self._rig.fundamental, self._parameters.alpha_epipolar_px).people:
            group.sort(key=lambda body: body.time_s)
            views = [body.camera for body in group]
            xyz_m = triangulate_robust(
                self._rig.image_from_world[views],
                np.array([body.points_px for body in group]),
                np.array([body.score for body in group]),
            )
            if is_body(xyz_m, spread_m(self._rig, group, xyz_m), self._parameters):
                bodies.append((group, xyz_m))
        lost = [target for target in self.targets if self._is_lost(target, time_s)]
        returning = find_returning(
            [xyz_m for _, xyz_m in bodies],
            Lost(
                np.array([target.xyz_m for target in lost]),
                np.array([target.velocity_m_s for target in lost]),
                np.array([time_s - target.moved_s for target in lost]),
            ),
            self._parameters,
        )
        for number, (group, xyz_m) in enumerate(bodies):
            target = self._resume(lost[returning[number]]) if number in returning else self._new_target()
            for body in group:
                target.observe(body, xyz_m, self._rig.image_from_world, self._parameters)
                self._identity[body.row] = target.target_id
                self._unmatched[body.camera].remove(body)
            self._move(target, time_s)

    def _is_lost(self, target: Target, time_s: float) -> bool:
        unseen_s = time_s - target.matched_s.max()
        return bool(target.confirmed and unseen_s > self._parameters.velocity_window_s)

    def _new_target(self) -> Target:
        target = Target.empty(self._num_born, len(self._cameras), self._frames.score.shape[1])
        self._num_born += 1
        self.targets.append(target)
        return target

    def _resume(self, lost: Target) -> Target:
        """Restart a lost target: its state is cleared, its number and its confirmation stay."""
        target = Target.empty(lost.target_id, len(self._cameras), self._frames.score.shape[1])
        target.num_supported, target.confirmed = lost.num_supported, True
        self.targets[self.targets.index(lost)] = target
        return target

    def _bury(self, time_s: float) -> None:
        """End targets that no two cameras have seen for longer than their limit."""
        limits_s = {True: self._parameters.max_unseen_s, False: self._parameters.max_unseen_tentative_s}
        self.targets = [
            target
            for target in self.targets
            if time_s - max(target.supported_s, target.moved_s) <= limits_s[target.confirmed]
        ]

    def _merge_duplicates(self, time_s: float) -> None:
        """Merge targets at the same place: a target with recent support stays, else the one with more support.

        The detections of a tentative duplicate go to the target that stays. A confirmed duplicate ends and keeps its
        detections: it may be a person who left the scene and whose prediction moved into another person.
        """

        def rank(target: Target) -> tuple[bool, int, int]:
            is_old = time_s - target.supported_s > self._parameters.velocity_window_s
            return (is_old, -target.num_supported, target.target_id)

        gone: set[int] = set()
        for i, target in enumerate(self.targets):
            for other in self.targets[i + 1 :]:
                if gone & {target.target_id, other.target_id} or not self._same_place(target, other):
                    continue
                twin, loser = sorted((target, other), key=rank)
                gone.add(loser.target_id)
                if not loser.confirmed:
                    self._replaced[loser.target_id] = twin.target_id
        self.targets = [target for target in self.targets if target.target_id not in gone]

    def _same_place(self, a: Target, b: Target) -> bool:
        apart_m = np.linalg.norm(a.xyz_m - b.xyz_m, axis=-1)
        known = np.isfinite(apart_m)
        return bool(known.sum() >= 3 and apart_m[known].mean() < self._parameters.duplicate_m)
