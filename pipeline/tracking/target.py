"""A person being tracked: the state that the paper keeps a target (Chen et al. 2020, section 3.2)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from pipeline.geometry.triangulation import triangulate_robust
from pipeline.tracking.parameters import TrackingParameters


@dataclass(slots=True, eq=False)
class Target:
    """State of one tracked person; changes with every matched frame.

    Parameters
    ----------
    target_id
        From 0, in order of birth.
    xyz_m, updated_s
        Last position of each joint (NaN if it never had one) and its time t'.
    velocity_m_s
        Of each joint, 0 while unknown.
    last_px, last_score, matched_s
        For every camera the joints of the last match (undistorted, NaN where unseen), their scores and its time t''
        (-inf if there was none).
    recent
        Instants and positions behind the velocity.
    supported_s, num_supported
        Last instant at which two cameras saw the target together, and how many of them there were.
    """

    target_id: int
    xyz_m: Float[np.ndarray, "joints 3"]
    updated_s: Float[np.ndarray, " joints"]
    velocity_m_s: Float[np.ndarray, "joints 3"]
    last_px: Float[np.ndarray, "cameras joints 2"]
    last_score: Float[np.ndarray, "cameras joints"]
    matched_s: Float[np.ndarray, " cameras"]
    recent: list[tuple[float, Float[np.ndarray, "joints 3"]]] = field(default_factory=list)
    supported_s: float = -np.inf
    num_supported: int = 0
    confirmed: bool = False

    @classmethod
    def empty(cls, target_id: int, num_cameras: int, num_joints: int) -> "Target":
        """Make a target that nobody has seen yet."""
        return cls(
            target_id=target_id,
            xyz_m=np.full((num_joints, 3), np.nan),
            updated_s=np.full(num_joints, -np.inf),
            velocity_m_s=np.zeros((num_joints, 3)),
            last_px=np.full((num_cameras, num_joints, 2), np.nan),
            last_score=np.zeros((num_cameras, num_joints)),
            matched_s=np.full(num_cameras, -np.inf),
        )

    def observe(
        self,
        camera: int,
        time_s: float,
        points_px: Float[np.ndarray, "joints 2"],
        score: Float[np.ndarray, " joints"],
    ) -> None:
        """Remember a matched detection (undistorted pixels)."""
        self.last_px[camera] = points_px
        self.last_score[camera] = score
        self.matched_s[camera] = time_s

    def move(self, time_s: float, xyz_m: Float[np.ndarray, "joints 3"], parameters: TrackingParameters) -> None:
        """Take in the joints as triangulated now, NaN where that was not possible."""
        seen = np.isfinite(xyz_m[:, 0])
        self.xyz_m = np.where(seen[:, None], xyz_m, self.xyz_m)
        self.updated_s = np.where(seen, time_s, self.updated_s)
        self._fit_velocity(time_s, xyz_m, parameters.velocity_window_s)
        if np.sum(time_s - self.matched_s < parameters.instant_s) >= 2 and time_s > self.supported_s:
            self.supported_s = time_s
            self.num_supported += 1
            self.confirmed |= self.num_supported >= parameters.confirm_instants

    def _fit_velocity(self, time_s: float, xyz_m: Float[np.ndarray, "joints 3"], window_s: float) -> None:
        """Linear least squares over the recent positions, one an instant (eq. 5)."""
        if self.recent and self.recent[-1][0] == time_s:
            self.recent.pop()
        self.recent = [(at_s, xyz) for at_s, xyz in self.recent if time_s - at_s <= window_s]
        self.recent.append((time_s, xyz_m))
        at_s = np.array([at for at, _ in self.recent])
        positions_m = np.array([xyz for _, xyz in self.recent])
        known = np.isfinite(positions_m[..., 0])
        count = known.sum(0)
        since_s = np.where(known, at_s[:, None] - time_s, 0.0)
        mean_s = since_s.sum(0) / np.maximum(count, 1)
        centred_s = np.where(known, since_s - mean_s, 0.0)
        spread = (centred_s**2).sum(0)
        slope = np.einsum("nj,nja->ja", centred_s, np.where(known[..., None], positions_m, 0.0))
        # Two instants alone would take the noise for speed.
        usable = (count >= 3) & (spread > 0)
        self.velocity_m_s = np.where(usable[:, None], slope / np.where(usable, spread, 1.0)[:, None], 0.0)


def update(
    targets: Sequence[Target],
    time_s: float,
    predicted_m: Float[np.ndarray, "targets joints 3"],
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    parameters: TrackingParameters,
) -> None:
    """Triangulate incrementally from the last match of every camera (eq. 6-11), then fit velocities (eq. 5).

    Weights fall with the age of an observation, ``exp(-lambda_t (t - t_i))``, and with doubt: the detector's
    confidence, and how far the other views and the prediction say it is off. All targets at once.
    """
    age_s = time_s - np.array([target.matched_s for target in targets])
    fresh = age_s < parameters.velocity_window_s
    penalty = np.where(fresh, np.exp(-parameters.lambda_t_hz * np.where(fresh, age_s, 0.0)), 0.0)
    score = np.array([target.last_score for target in targets])
    points_px = np.array([target.last_px for target in targets])
    found_m = triangulate_robust(image_from_world, points_px, penalty[..., None] * score, guess_m=predicted_m)
    for target, xyz_m in zip(targets, found_m, strict=True):
        target.move(time_s, xyz_m, parameters)
