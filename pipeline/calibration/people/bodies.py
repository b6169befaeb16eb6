"""Bodies: what all cameras see of one person at one instant, put together from matched tracklets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.calibration.people.following import JOINTS
from pipeline.calibration.people.pairs import RelativePose
from pipeline.calibration.people.tracklets import ViewTracklet
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.geometry.tracks import triangulate_instants


@dataclass(frozen=True, slots=True, eq=False)
class MatchedBodies:
    """Bodies of groups of tracklets, sorted by group and instant."""

    group: Int[np.ndarray, " n"]  # Number of the group: one person, who may have several groups
    instant: Int[np.ndarray, " n"]  # Instant of each body
    # Distorted pixels of ``JOINTS``, NaN where a camera does not see the joint
    points_px: Float[np.ndarray, "n cameras joints 2"]

    def __len__(self) -> int:
        return len(self.group)

    def subset(self, chosen: Bool[np.ndarray, " n"] | Int[np.ndarray, " m"]) -> "MatchedBodies":
        """Select bodies."""
        return MatchedBodies(self.group[chosen], self.instant[chosen], self.points_px[chosen])

    def without(self, hidden: Bool[np.ndarray, "n cameras joints"]) -> "MatchedBodies":
        """Leave out some views of joints."""
        return MatchedBodies(self.group, self.instant, read_only(np.where(hidden[..., None], np.nan, self.points_px)))

    def seen(self) -> Bool[np.ndarray, "n cameras joints"]:
        """Joints that each camera sees."""
        return np.isfinite(self.points_px).all(-1)

    def in_cameras(self, numbers: Sequence[int]) -> "MatchedBodies":
        """Bodies as some cameras see them."""
        return MatchedBodies(self.group, self.instant, self.points_px[:, list(numbers)])

    def triangulated(self, cameras: Sequence[Camera]) -> Float[np.ndarray, "n joints 3"]:
        """World coordinates of the joints; NaN where fewer than two cameras see one."""
        return triangulate_instants(cameras, self.points_px)


def gather_bodies(
    tracklets: Sequence[ViewTracklet], relatives: Sequence[RelativePose], num_cameras: int
) -> MatchedBodies:
    """Put matched tracklets together, the best matches first; one camera sees a person once at an instant."""
    group = np.arange(len(tracklets))
    matches = sorted((match for kept in relatives for match in kept.matches), key=lambda match: -match.support)
    members: dict[int, list[int]] = {number: [number] for number in range(len(tracklets))}
    for match in matches:
        kept, added = int(group[match.first]), int(group[match.second])
        if kept != added and not _overlap(members[kept], members[added], tracklets):
            group[members[added]] = kept
            members[kept] += members.pop(added)
    parts = [_match_bodies(number, [tracklets[k] for k in own], num_cameras) for number, own in members.items()
             if len({tracklets[k].camera for k in own}) > 1]  # fmt: skip
    if not parts:
        return MatchedBodies(np.empty(0, int), np.empty(0, int), np.empty((0, num_cameras, len(JOINTS), 2)))
    return MatchedBodies(
        np.concatenate([part.group for part in parts]),
        np.concatenate([part.instant for part in parts]),
        np.concatenate([part.points_px for part in parts]),
    )


def _overlap(some: Sequence[int], others: Sequence[int], tracklets: Sequence[ViewTracklet]) -> bool:
    """True if a camera would see the person twice at an instant."""
    return any(
        tracklets[k].camera == tracklets[m].camera and len(tracklets[k].shared(tracklets[m])) > 0
        for k in some
        for m in others
    )


def _match_bodies(number: int, own: Sequence[ViewTracklet], num_cameras: int) -> MatchedBodies:
    first, stop = min(tracklet.first for tracklet in own), max(tracklet.instants.stop for tracklet in own)
    points_px = np.full((stop - first, num_cameras, len(JOINTS), 2), np.nan)
    for tracklet in own:
        points_px[tracklet.first - first : tracklet.instants.stop - first, tracklet.camera] = tracklet.points_px
    is_shared = (np.isfinite(points_px).all(-1).any(-1)).sum(-1) >= 2
    instant = np.arange(first, stop)[is_shared]
    return MatchedBodies(np.full(len(instant), number), instant, points_px[is_shared])
