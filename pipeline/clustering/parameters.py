"""Parameters of 3D hypothesis clustering, and their defaults for a session."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.data.cameras import Camera

# Diagonal of the paper's images of Shelf (Panoptic is larger; the text gives one threshold for all data sets).
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
        Factor by which either connectivity or length may miss its threshold while the other meets it. Applies to
        parents that eq. 2 and 3 leave without a hypothesis, and to limbs in parsing; the paper's value is 1.
    eps_m
        DBSCAN's eps: distance below which hypotheses are neighbours. It covers the spread of a joint and is well below
        half a shoulder's width. Two views give a single hypothesis, so a cluster may have a single member.
    split_clusters
        Whether a cluster with several parents is split (section 3.2.2).
    separate_clusters
        Whether a cluster of several merged joints gives all of them, the densest first; the paper's gives one joint.
    use_connectivity, use_lengths
        Whether eq. 2 and eq. 3 constrain hypotheses and limbs (the paper's ablation, table 3). Limbs are always joined
        in order of their connectivity scores.
    min_score
        Least score of a 2D candidate.
    duplicate_m
        Mean joint distance below which two poses are the same person, seen by different cameras.
    min_joints
        Least number of joints of a pose, counted among the paper's 14.
    max_unseen_s
        Longest gap without a pose within a track.
    speed_m_s
        Largest speed of the centre of a body.
    length_rate_hz
        Rate of the poses from which bone lengths are measured.
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
    """Derive the default parameters of a session: ``tau1`` is 8 px scaled by the image diagonal, at least 4 px.

    Parameters
    ----------
    tau2
        Least connectivity score; by default the paper's. Networks with part affinity fields have their own value.
    """
    diagonal_px = float(np.median([np.hypot(*camera.size_px) for camera in cameras]))
    return ClusteringParameters(max(_LEAST_TAU1_PX, _PAPER_TAU1_PX * diagonal_px / _PAPER_DIAGONAL_PX), tau2)
