"""Parameters of 3D hypothesis clustering, and their defaults for a session."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.data import Camera

# Of the paper's images (Panoptic is larger; the text gives one threshold for all).
_PAPER_DIAGONAL_PX = float(np.hypot(1032, 776))
_PAPER_TAU1_PX = 8.0
_LEAST_TAU1_PX = 4.0


@dataclass(frozen=True, slots=True)
class ClusteringParameters:
    """Parameters of 3D hypothesis clustering; the first three are the paper's.

    Parameters
    ----------
    tau1_px
        Largest reprojection error of a hypothesis.
    tau2
        Least connectivity score of a hypothesis with its parent (eq. 2).
    tau3
        Largest relative difference to a bone's length (eq. 3).
    eps_m
        Hypotheses closer than this are one joint (DBSCAN's eps): the joint's own spread, well below half a shoulder's
        width. Two views give a single hypothesis, so a cluster may have one.
    split_clusters
        Whether a cluster that several parents claim is split (section 3.2.2).
    min_score
        Joints below are no candidates.
    duplicate_m
        Two poses whose joints are on average closer than this are one person's, seen by different cameras.
    min_joints
        Poses of fewer joints (of the paper's 14) are nobody.
    max_unseen_s
        A track goes on after so long without a pose.
    speed_m_s
        How fast the middle of a body may move.
    length_rate_hz
        How often poses are taken for bone lengths.
    """

    tau1_px: float
    tau2: float = 0.3
    tau3: float = 0.1
    eps_m: float = 0.1
    split_clusters: bool = True
    min_score: float = 0.1
    duplicate_m: float = 0.2
    min_joints: int = 5
    max_unseen_s: float = 0.5
    speed_m_s: float = 4.0
    length_rate_hz: float = 5.0


def derive_parameters(cameras: Sequence[Camera]) -> ClusteringParameters:
    """Defaults for a session: ``tau1`` is the paper's 8 px, scaled by the images' diagonal, no less than 4 px."""
    diagonal_px = float(np.median([np.hypot(*camera.size_px) for camera in cameras]))
    return ClusteringParameters(tau1_px=max(_LEAST_TAU1_PX, _PAPER_TAU1_PX * diagonal_px / _PAPER_DIAGONAL_PX))
