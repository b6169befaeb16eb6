"""What says that two joints are one person's: part affinity fields, or bodies that a detector found whole.

Both give the connectivity score S of a parent and a point in space (eq. 1): the mean over views of what each view says.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from pipeline.clustering.skeleton import Skeleton
from pipeline.data import Camera, MapGrid
from pipeline.geometry.camera import project
from pipeline.geometry.fields import connectivity

NOWHERE = -1
"""Stands for a detection or a candidate where there is none."""


class Places(NamedTuple):
    """Points in space that may be joints.

    Parameters
    ----------
    joint
        Which joint of the skeleton, (points,).
    xyz_m
        (points, 3).
    body
        The detection behind a point in each view, or behind its ancestors where it has none itself, (points, cameras),
        ``NOWHERE`` where nobody knows.
    """

    joint: np.ndarray
    xyz_m: np.ndarray
    body: np.ndarray


@runtime_checkable
class Evidence(Protocol):
    """What connects points to parents at an instant."""

    @property
    def least(self) -> Float[np.ndarray, " joints"]:
        """The least score of each joint of the skeleton with its parent: tau2 of eq. 2."""

    def connect(
        self, parents: Places, points: Places, wanted: Bool[np.ndarray, "parents points"]
    ) -> Float[np.ndarray, "parents points"]:
        """Connectivity scores S of wanted pairs (eq. 1); NaN for others, and where no view can tell."""


class Membership:
    """Evidence of whole bodies: in a view that knows the detections behind both points, s is 1 if they are the same.

    Parameters
    ----------
    tau2
        Of all joints.
    """

    def __init__(self, skeleton: Skeleton, tau2: float) -> None:
        self.least = np.full(len(skeleton.names), tau2)

    def connect(
        self, parents: Places, points: Places, wanted: Bool[np.ndarray, "parents points"]
    ) -> Float[np.ndarray, "parents points"]:
        """Mean of s over the views that know both; see ``Evidence``."""
        num_known, num_same = np.zeros(wanted.shape, np.int32), np.zeros(wanted.shape, np.int32)
        for parent, point in zip(parents.body.T, points.body.T, strict=True):
            known = (parent[:, None] >= 0) & (point >= 0)
            num_known += known
            num_same += known & (parent[:, None] == point)
        return np.where(wanted & (num_known > 0), num_same / np.maximum(num_known, 1), np.nan)


class ViewFields(NamedTuple):
    """One camera's fields at an instant; see ``data.PafFields``."""

    camera: Camera
    fields: UInt8[np.ndarray, "limbs 2 height width"]
    grid: MapGrid


class AffinityFields:
    """Evidence of part affinity fields: s is the field's mean along the segment between the two projections.

    The segment is straight in the image as seen. The paper takes the mean over all views; here it is over those whose
    image shows both ends, which are all of them where cameras look at one place.

    Parameters
    ----------
    views
        Of the cameras that have a frame at the instant.
    limbs
        Which joints of the detector each field leads from and to.
    tau2
        See ``FieldGrid``; joints that hang on a limb with weak fields take a share of it.
    """

    def __init__(
        self, views: Sequence[ViewFields], limbs: Int[np.ndarray, "limbs 2"], skeleton: Skeleton, tau2: float
    ) -> None:
        self._views = views
        self._limb_of = limbs_of(skeleton, limbs)
        self.least = tau2 * np.array(skeleton.field_share)

    def connect(
        self, parents: Places, points: Places, wanted: Bool[np.ndarray, "parents points"]
    ) -> Float[np.ndarray, "parents points"]:
        """Mean of s over the views that show both; see ``Evidence``."""
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


def limbs_of(skeleton: Skeleton, limbs: Int[np.ndarray, "limbs 2"]) -> Int[np.ndarray, " joints"]:
    """The field of each joint's limb, ``NOWHERE`` where a network has none."""
    numbers = {tuple(limb): number for number, limb in enumerate(limbs.tolist())}
    sources = skeleton.sources
    return np.array(
        [
            numbers.get((sources[parent], sources[j]), NOWHERE) if parent >= 0 else NOWHERE
            for j, parent in enumerate(skeleton.parents)
        ]
    )
