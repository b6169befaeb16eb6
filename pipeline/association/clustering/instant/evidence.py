"""Evidence that two joints belong to the same person: part affinity fields, or a detector's bodies.

Both give the connectivity score S of a parent joint and a 3D point (eq. 1): the mean over views of a score s in each
view.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from pipeline.association.clustering.skeleton import Skeleton
from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import MapGrid
from pipeline.geometry.camera import project
from pipeline.geometry.fields import connectivity

NOWHERE = -1
"""Number of a missing detection or candidate."""


class JointPoints(NamedTuple):
    """3D points that may be joints."""

    joint: np.ndarray  # Number of the joint in the skeleton, (points,)
    xyz_m: np.ndarray  # World positions, (points, 3)
    # Detection behind a point in each view, else the detection of its nearest ancestor with a detection, (points,
    # cameras); ``NOWHERE`` if unknown
    body: np.ndarray


@runtime_checkable
class LimbEvidence(Protocol):
    """Evidence for connections between parent joints and points at an instant."""

    @property
    def least(self) -> Float[np.ndarray, " joints"]:
        """Least score of each joint of the skeleton with its parent: tau2 of eq. 2."""

    def connect(
        self, parents: JointPoints, points: JointPoints, wanted: Bool[np.ndarray, "parents points"]
    ) -> Float[np.ndarray, "parents points"]:
        """Connectivity scores S of wanted pairs (eq. 1); NaN for other pairs and for pairs without evidence."""


class Membership:
    """Evidence from a detector's bodies: in a view with detections behind both points, s is 1 if they are the same.

    ``tau2`` is the least score of every joint with its parent (eq. 2).
    """

    def __init__(self, skeleton: Skeleton, tau2: float) -> None:
        self.least = np.full(len(skeleton.names), tau2)

    def connect(
        self, parents: JointPoints, points: JointPoints, wanted: Bool[np.ndarray, "parents points"]
    ) -> Float[np.ndarray, "parents points"]:
        """Mean of s over the views with detections behind both points; see ``LimbEvidence``."""
        num_known, num_same = np.zeros(wanted.shape, np.int32), np.zeros(wanted.shape, np.int32)
        for parent, point in zip(parents.body.T, points.body.T, strict=True):
            known = (parent[:, None] >= 0) & (point >= 0)
            num_known += known
            num_same += known & (parent[:, None] == point)
        return np.where(wanted & (num_known > 0), num_same / np.maximum(num_known, 1), np.nan)


class ViewFields(NamedTuple):
    """Part affinity fields of one camera at an instant; see ``data.detections.PafFields``."""

    camera: Camera
    fields: UInt8[np.ndarray, "limbs 2 height width"]
    grid: MapGrid


class AffinityFields:
    """Evidence from part affinity fields: s is the field's mean along the segment between the two projections.

    The segment is straight in the distorted image. The paper takes the mean over all views; here it is taken over the
    views whose image contains both ends.

    ``views``: fields of the cameras that have a frame at the instant. ``limbs``: first and second joint of each field's
    limb, as numbers in the detector's order. ``tau2``: least score of a joint with its parent, see ``FieldGrid``;
    scaled by ``Limb.field_share``.
    """

    def __init__(
        self, views: Sequence[ViewFields], limbs: Int[np.ndarray, "limbs 2"], skeleton: Skeleton, tau2: float
    ) -> None:
        self._views = views
        self._limb_of = number_limbs(skeleton, limbs)
        self.least = tau2 * np.array(skeleton.field_share)

    def connect(
        self, parents: JointPoints, points: JointPoints, wanted: Bool[np.ndarray, "parents points"]
    ) -> Float[np.ndarray, "parents points"]:
        """Mean of s over the views that contain both projections; see ``LimbEvidence``."""
        limb = self._limb_of[points.joint]
        parent, point = np.nonzero(wanted & (limb >= 0))
        used, number = np.unique(point, return_inverse=True)
        total, num_views = np.zeros(len(parent)), np.zeros(len(parent), int)
        for view in self._views:
            begin = view.grid.map_from_image(project(view.camera, parents.xyz_m))
            end = view.grid.map_from_image(project(view.camera, points.xyz_m[used]))
            score, _ = connectivity(view.fields, limb[point], begin[parent], end[number])
            sees = ~np.isnan(score)
            total += np.where(sees, score, 0.0)
            num_views += sees
        scores = np.full(wanted.shape, np.nan)
        scores[parent, point] = np.where(num_views > 0, total / np.maximum(num_views, 1), np.nan)
        return scores


def number_limbs(skeleton: Skeleton, limbs: Int[np.ndarray, "limbs 2"]) -> Int[np.ndarray, " joints"]:
    """Number of the field of each joint's limb, ``NOWHERE`` if the network has no such field."""
    numbers = {tuple(limb): number for number, limb in enumerate(limbs.tolist())}
    sources = skeleton.sources
    return np.array(
        [
            numbers.get((sources[parent], sources[j]), NOWHERE) if parent >= 0 else NOWHERE
            for j, parent in enumerate(skeleton.parents)
        ]
    )
