"""Joints of the matched track of each true person."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import JointSet
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, UNMATCHED, match_frames, select_joints
from pipeline.validation.simulation.scenes import Simulation


def matched_joints(
    tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet, names: Sequence[str]
) -> tuple[Float[np.ndarray, "people frames names 3"], Bool[np.ndarray, "people frames names"]]:
    """Positions of joints of the track that is matched to each person by the body, and whether they are measured.

    World positions are NaN without a match and for names that ``joints`` lacks; a joint is measured if the track's
    source is ``MEASURED``.
    """
    frames = np.arange(simulation.timebase.num_frames)
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(BODY_JOINTS)]
    matched = match_frames(select_joints(tracks, joints, BODY_JOINTS, frames), truth_m)
    nobody = np.full((1, len(frames), len(names), 3), np.nan)
    taken_m = np.concatenate([select_joints(tracks, joints, names, frames), nobody])
    measured = np.zeros(taken_m.shape[:3], dtype=bool)
    shared = [k for k, name in enumerate(names) if name in joints.names]
    columns = [joints.index(names[k]) for k in shared]
    for row, track in enumerate(tracks):
        rows = slice(track.start_frame, track.start_frame + track.num_frames)
        measured[row, rows, shared] = (track.source[:, columns] == Source.MEASURED).T
    row_of = np.where(matched == UNMATCHED, len(tracks), matched)
    return taken_m[row_of, frames], measured[row_of, frames]


def mean_of(values: np.ndarray) -> float | None:
    """Mean of the finite values, ``None`` without any."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None
