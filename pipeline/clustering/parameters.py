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
    leniency
        How many times worse connectivity or length may be where the other is as it should, for a parent whom eq. 2 and
        3 leave no hypothesis, and for limbs in parsing; 1 is the paper's.
    eps_m
        Hypotheses closer than this are one joint (DBSCAN's eps): the joint's own spread, well below half a shoulder's
        width. Two views give a single hypothesis, so a cluster may have one.
    split_clusters
        Whether a cluster that several parents claim is split (section 3.2.2).
    separate_clusters
        Whether a cluster into which several joints have run together gives each of them, the densest first; the paper's
        gives one joint.
    use_connectivity, use_lengths
        Whether eq. 2 and eq. 3 constrain hypotheses and limbs (the paper's ablation, table 3). Without, limbs are
        joined by the connectivity score all the same, the best first.
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
    leniency: float = 2.0
    eps_m: float = 0.1
    split_clusters: bool = True
    separate_clusters: bool = True
    use_connectivity: bool = True
    use_lengths: bool = True
    min_score: float = 0.1
    duplicate_m: float = 0.2
    min_joints: int = 5
    max_unseen_s: float = 0.5
    speed_m_s: float = 4.0
    length_rate_hz: float = 5.0


def derive_parameters(cameras: Sequence[Camera], tau2: float = 0.3) -> ClusteringParameters:
    """Defaults for a session: ``tau1`` is the paper's 8 px, scaled by the images' diagonal, no less than 4 px.

    Parameters
    ----------
    tau2
        The network's, where part affinity fields are the evidence; the paper's otherwise.
    """
    diagonal_px = float(np.median([np.hypot(*camera.size_px) for camera in cameras]))
    return ClusteringParameters(max(_LEAST_TAU1_PX, _PAPER_TAU1_PX * diagonal_px / _PAPER_DIAGONAL_PX), tau2)
