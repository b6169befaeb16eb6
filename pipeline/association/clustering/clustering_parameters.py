"""Parameters of 3D hypothesis clustering, and their defaults for a session."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.data.cameras import Camera

# Diagonal of the paper's images of Shelf (Panoptic is larger; the text gives one threshold for all data sets).
_PAPER_DIAGONAL_PX = float(np.hypot(1032, 776))
_PAPER_TAU1_PX = 8.0
_LEAST_TAU1_PX = 4.0


@dataclass(frozen=True, slots=True)
class ClusteringParameters:
    """Parameters of 3D hypothesis clustering; the first three are the paper's."""

    tau1_px: float  # Largest reprojection error of a hypothesis
    tau2: float = 0.3  # Least connectivity score of a hypothesis with its parent (eq. 2)
    tau3: float = 0.1  # Largest relative difference to a bone's length (eq. 3)
    # Factor by which either connectivity or length may miss its threshold while the other meets it. Applies to parents
    # that eq. 2 and 3 leave without a hypothesis, and to limbs in parsing; the paper's value is 1.
    leniency: float = 2.0
    # DBSCAN's eps: distance below which hypotheses are neighbours. It covers the spread of a joint and is well below
    # half a shoulder's width. Two views give a single hypothesis, so a cluster may have a single member.
    eps_m: float = 0.1
    split_clusters: bool = True  # True if a cluster with several parents is split (section 3.2.2)
    # A cluster of several merged joints gives all of them, the densest first; the paper's gives one joint
    separate_clusters: bool = True
    # Eq. 2 and eq. 3 constrain hypotheses and limbs (the paper's ablation, table 3). Limbs are always joined in
    # order of their connectivity scores.
    use_connectivity: bool = True
    use_lengths: bool = True
    min_score: float = 0.1  # Least score of a 2D candidate
    duplicate_m: float = 0.2  # Mean joint distance below which two poses are the same person, seen by different cameras
    # Least number of joints, counted among the paper's 14, of a pose that is not found from whole bodies
    min_joints: int = 5
    max_unseen_s: float = 0.5  # Longest gap without a pose within a track
    speed_m_s: float = 4.0  # Largest speed of the centre of a body
    length_rate_hz: float = 5.0  # Rate of the poses from which bone lengths are measured


def derive_parameters(cameras: Sequence[Camera], tau2: float = 0.3) -> ClusteringParameters:
    """Derive the default parameters of a session: ``tau1`` is 8 px scaled by the image diagonal, at least 4 px.

    ``tau2`` is the least connectivity score, by default the paper's; networks with part affinity fields have their own.
    """
    diagonal_px = float(np.median([np.hypot(*camera.size_px) for camera in cameras]))
    return ClusteringParameters(max(_LEAST_TAU1_PX, _PAPER_TAU1_PX * diagonal_px / _PAPER_DIAGONAL_PX), tau2)
