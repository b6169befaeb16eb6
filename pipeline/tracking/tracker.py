"""Cross-view tracking, frame by frame (Chen et al. 2020, algorithm 1).

Each frame comes from one camera at its own time: no synchronisation is assumed. Its detections are matched to targets
in 3D space; what stays unmatched starts new targets together with the most recent frames of the other cameras.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.data import Camera
from pipeline.geometry.camera import center_in_world, image_from_world, rays_in_world
from pipeline.geometry.epipolar import fundamental_matrix
from pipeline.tracking.affinity import affinity, correspondence_2d, correspondence_3d, predict, ray_distance_m
from pipeline.tracking.assignment import assign
from pipeline.tracking.initialization import Unmatched, group_unmatched, is_body
from pipeline.tracking.parameters import TrackingParameters
from pipeline.tracking.target import Target, update

# The identity of a detection that belongs to nobody.
NOBODY = -1


@dataclass(slots=True, eq=False)
class _View:
    """What the tracker knows of one camera, and its most recent unmatched detections."""

    camera: Camera
    center_m: Float[np.ndarray, " 3"]
    unmatched: list[Unmatched]


class Tracker:
    """Matches detections to people, one frame of one camera at a time, in time order.

    Parameters
    ----------
    cameras
        The session's cameras; frames name them by position.
    num_joints
        Joints a detection.
    parameters
        See ``derive_parameters``.
    """

    def __init__(self, cameras: Sequence[Camera], num_joints: int, parameters: TrackingParameters) -> None:
        self._parameters = parameters
        self._num_joints = num_joints
        self._views = [_View(camera, center_in_world(camera), []) for camera in cameras]
        self._image_from_world = np.array([image_from_world(camera) for camera in cameras])
        self._fundamentals = np.array(
            [[fundamental_matrix(a, b) if a is not b else np.full((3, 3), np.nan) for b in cameras] for a in cameras]
        )
        self._targets: list[Target] = []
        self._num_born = 0
        self._replaced: dict[int, int] = {}
        self._confirmed: set[int] = set()

    @property
    def confirmed(self) -> frozenset[int]:
        """Identities that earned their birth so far, dead ones included."""
        return frozenset(self._confirmed)

    @property
    def num_born(self) -> int:
        """Number of identities given out."""
        return self._num_born

    def identity(self, target_id: int) -> int:
        """The identity that a target goes by after duplicates were merged."""
        while target_id in self._replaced:
            target_id = self._replaced[target_id]
        return target_id

    def step(
        self,
        camera: int,
        time_s: float,
        points_px: Float[np.ndarray, "detections joints 2"],
        score: Float[np.ndarray, "detections joints"],
    ) -> tuple[Int[np.ndarray, " detections"], list[tuple[int, int, int]]]:
        """Take in one frame.

        Parameters
        ----------
        camera
            Position of the camera.
        time_s
            The frame's time, not before that of the frame taken in last.
        points_px
            Joints in undistorted pixels, NaN where unseen or unsure.
        score
            Confidence of each joint, 0 where it is NaN.

        Returns
        -------
        identities
            Target of each detection, ``NOBODY`` where there is none.
        late
            (camera, detection, identity) of detections of other cameras' most recent frames that a new target claims.
        """
        view = self._views[camera]
        identities = np.full(len(score), NOBODY)

        self._bury(time_s)
        predicted_m = self._predict(time_s)
        pairs = self._match(camera, time_s, points_px, rays_in_world(view.camera, points_px), predicted_m)
        for i, j in pairs:
            self._targets[i].observe(camera, time_s, points_px[j], score[j])
            identities[j] = self._targets[i].target_id
        if pairs:
            matched = [i for i, _ in pairs]
            update(
                [self._targets[i] for i in matched],
                time_s,
                predicted_m[matched],
                self._image_from_world,
                self._parameters,
            )

        view.unmatched = [
            Unmatched(camera, int(j), time_s, points_px[j], score[j]) for j in np.flatnonzero(identities == NOBODY)
        ]
        late = self._start_targets(time_s)
        for claimed_camera, row, target_id in late:
            if claimed_camera == camera:
                identities[row] = target_id
        self._merge_duplicates(time_s)
        self._confirmed.update(target.target_id for target in self._targets if target.confirmed)
        return identities, [claim for claim in late if claim[0] != camera]

    def _predict(self, time_s: float) -> Float[np.ndarray, "targets joints 3"]:
        if not self._targets:
            return np.empty((0, self._num_joints, 3))
        return predict(
            np.array([target.xyz_m for target in self._targets]),
            np.array([target.velocity_m_s for target in self._targets]),
            np.array([time_s - target.updated_s for target in self._targets]),
            self._parameters.max_extrapolation_s,
        )

    def _match(
        self,
        camera: int,
        time_s: float,
        points_px: Float[np.ndarray, "detections joints 2"],
        rays: Float[np.ndarray, "detections joints 3"],
        predicted_m: Float[np.ndarray, "targets joints 3"],
    ) -> list[tuple[int, int]]:
        """Pairs of target and detection by the affinity of eq. 1; confirmed targets choose first."""
        if not self._targets or not len(points_px):
            return []
        last_px = np.array([target.last_px[camera] for target in self._targets])
        gap_s = np.array([time_s - target.matched_s[camera] for target in self._targets])
        age_s = np.array([time_s - target.updated_s for target in self._targets])
        affinities = affinity(
            correspondence_2d(points_px, last_px, gap_s, self._parameters),
            correspondence_3d(rays, self._views[camera].center_m, predicted_m, age_s, self._parameters),
        )
        pairs: list[tuple[int, int]] = []
        free = np.ones(len(points_px), bool)
        for confirmed in (True, False):
            rows = np.flatnonzero([target.confirmed == confirmed for target in self._targets])
            columns = np.flatnonzero(free)
            chosen = assign(affinities[np.ix_(rows, columns)])
            pairs.extend((int(rows[i]), int(columns[j])) for i, j in chosen)
            free[[int(columns[j]) for _, j in chosen]] = False
        return pairs

    def _start_targets(self, time_s: float) -> list[tuple[int, int, int]]:
        """New targets from what is unmatched in every camera's most recent frame."""
        pool = [
            one for view in self._views for one in view.unmatched if time_s - one.time_s < self._parameters.instant_s
        ]
        if len({one.camera for one in pool}) < 2:
            return []
        claims: list[tuple[int, int, int]] = []
        for group in group_unmatched(pool, self._fundamentals, self._parameters.alpha_epipolar_px):
            target = Target.empty(self._num_born, len(self._views), self._num_joints)
            for one in group:
                target.observe(one.camera, one.time_s, one.points_px, one.score)
            update([target], time_s, target.xyz_m[None], self._image_from_world, self._parameters)
            if not is_body(target.xyz_m, self._spread_m(target), self._parameters):
                continue
            self._targets.append(target)
            self._num_born += 1
            for one in group:
                self._views[one.camera].unmatched.remove(one)
                claims.append((one.camera, one.row, target.target_id))
        return claims

    def _spread_m(self, target: Target) -> float:
        """Median distance of a target's joints to the rays that made them."""
        distances_m = [
            ray_distance_m(
                target.xyz_m,
                self._views[camera].center_m,
                _rays(self._image_from_world[camera], target.last_px[camera]),
            )
            for camera in np.flatnonzero(np.isfinite(target.matched_s))
        ]
        known = np.array(distances_m)[np.isfinite(distances_m)]
        return float(np.median(known)) if known.size else np.inf

    def _bury(self, time_s: float) -> None:
        """End targets that two cameras have not seen for long."""
        kept = []
        for target in self._targets:
            limit_s = self._parameters.max_unseen_s if target.confirmed else self._parameters.max_unseen_tentative_s
            if time_s - max(target.supported_s, target.updated_s.max()) <= limit_s:
                kept.append(target)
        self._targets = kept

    def _merge_duplicates(self, time_s: float) -> None:
        """Two targets in one place are one person: the one that is seen now, or was seen more often, stays.

        A tentative target's detections go over to the one that stays. A confirmed one has a past of its own, such as
        somebody who left and coasts into another's way: it ends there, and its past stays what it was.
        """
        by_merit = sorted(
            self._targets,
            key=lambda target: (
                time_s - target.supported_s > self._parameters.velocity_window_s,
                -target.num_supported,
                target.target_id,
            ),
        )
        kept: list[Target] = []
        for target in by_merit:
            twin = next((other for other in kept if self._same_place(target, other)), None)
            if twin is None:
                kept.append(target)
            elif not target.confirmed:
                self._replaced[target.target_id] = twin.target_id
        self._targets = sorted(kept, key=lambda target: target.target_id)

    def _same_place(self, a: Target, b: Target) -> bool:
        apart_m = np.linalg.norm(a.xyz_m - b.xyz_m, axis=-1)
        known = np.isfinite(apart_m)
        return bool(known.sum() >= 3 and apart_m[known].mean() < self._parameters.duplicate_m)


def _rays(
    image_from_world: Float[np.ndarray, "3 4"], points_px: Float[np.ndarray, "joints 2"]
) -> Float[np.ndarray, "joints 3"]:
    """Unit viewing rays of undistorted pixels."""
    homogeneous = np.concatenate([points_px, np.ones_like(points_px[:, :1])], axis=-1)
    directions = homogeneous @ np.linalg.inv(image_from_world[:, :3]).T
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)
