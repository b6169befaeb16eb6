"""Rendered captures with exact truth: a folder of ``videos/``, ``calibration.toml`` and ``gt.npz``."""

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.data import Timebase, Track3D
from pipeline.errors import InputError, Problem
from pipeline.joints import COCO_17, JointSet
from pipeline.metrics.mpjpe import PositionScores, score_positions

# No face: rigs have no eyes and ears where annotators put them.
BODY_JOINTS = tuple(name for name in COCO_17.names if name.split("_")[-1] not in {"nose", "eye", "ear"})

_TRUTH_FILE = "gt.npz"


@dataclass(frozen=True, slots=True, eq=False)
class RenderedTruth:
    """Where everybody is at every instant; joints are those of COCO-17."""

    xyz_m: Float[np.ndarray, "people frames joints 3"]
    time_s: Float[np.ndarray, " frames"]


def load_truth(folder: Path) -> RenderedTruth:
    """Read ``gt.npz`` of a rendered capture.

    Raises
    ------
    InputError
        If it is missing, is no NumPy archive, or lacks ``joints`` or ``time`` in the right shape.
    """

    def refuse(message: str) -> InputError:
        return InputError(
            [Problem("truth_unreadable", message, file=_TRUTH_FILE, hint="Give the folder of a rendered capture.")]
        )

    if not (folder / _TRUTH_FILE).is_file():
        raise refuse("The folder has no ground truth.")
    try:
        with np.load(folder / _TRUTH_FILE, allow_pickle=False) as archive:
            xyz_m, time_s = np.array(archive["joints"], np.float64), np.array(archive["time"], np.float64)
    except KeyError as error:
        raise refuse("The file lacks 'joints' or 'time'.") from error
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise refuse("The file is no NumPy archive of plain arrays.") from error
    if xyz_m.ndim != 4 or xyz_m.shape[1:] != (len(time_s), len(COCO_17.names), 3):
        raise refuse("'joints' is not of shape people x frames x 17 x 3, or does not fit 'time'.")
    return RenderedTruth(xyz_m, time_s)


def score_rendered(
    tracks: Sequence[Track3D], joints: JointSet, timebase: Timebase, truth: RenderedTruth
) -> PositionScores:
    """Score tracks at the truth's instants: 12 body joints, Hungarian matching a frame, gate 0.5 m.

    An output frame counts for the instant that it is nearest to, within half a period.
    """
    columns = joints.indices(BODY_JOINTS)
    frames = np.round((truth.time_s - truth.time_s[0]) * timebase.frame_rate_hz).astype(int)
    predicted_m, track_ids = [], []
    for frame in frames:
        alive = [track for track in tracks if 0 <= frame - track.start_frame < track.num_frames]
        poses_m = [track.xyz_m[frame - track.start_frame][columns] for track in alive]
        seen = [k for k, pose_m in enumerate(poses_m) if np.isfinite(pose_m).any()]
        predicted_m.append(np.array([poses_m[k] for k in seen]).reshape(len(seen), len(columns), 3))
        track_ids.append(np.array([alive[k].track_id for k in seen], np.int64))
    true_columns = COCO_17.indices(BODY_JOINTS)
    return score_positions(predicted_m, track_ids, truth.xyz_m.transpose(1, 0, 2, 3)[:, :, true_columns])
