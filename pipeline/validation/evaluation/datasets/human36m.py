"""Human3.6M (Ionescu et al., PAMI 2014): reader of a subject's folder as downloaded, and scores.

The folder has ``MyPoseFeatures/D3_Positions/ACTION.cdf`` (``Pose``: 32 joints in millimetres at 50 Hz, in the world of
the cameras) and ``Videos/ACTION.CAMERA.mp4``; frame k of both is one instant. Papers score 17 of the joints. COCO has
13 of them: the limbs, and the middle of the hips. It lacks the spine, the thorax, the neck and the top of the head.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.calibration.similarity import umeyama
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.errors import InputError, PipelineError, Problem, listed_names
from pipeline.core.joints import JointSet
from pipeline.core.problems.finding_codes import BENCHMARK_UNREADABLE, DATASET_INCOMPLETE
from pipeline.validation.evaluation.datasets.read_truth import read_truth
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, UNMATCHED, accuracy, match_frames, select_joints

FRAME_RATE_HZ = 50.0

_POSES, _VIDEOS = Path("MyPoseFeatures", "D3_Positions"), "Videos"
# Places of BODY_JOINTS among the 32 joints, and of the middle of the hips.
_NUMBERS = [17, 25, 18, 26, 19, 27, 6, 1, 7, 2, 8, 3, 0]
_HIPS = [BODY_JOINTS.index(f"{side}_hip") for side in ("left", "right")]


def load_human36m(
    folder: Path, action: str, has_footage: bool = True
) -> tuple[tuple[Path, ...], Float[np.ndarray, "frames 13 3"]]:
    """Read an action of a subject: its videos, and the true joints in metres, the limbs' and the middle of the hips.

    ``has_footage``: whether videos are needed; else keypoints are given. Raises ``InputError`` with all that is missing
    or unreadable, ``PipelineError`` if ``cdflib`` is not installed.
    """
    if find_spec("cdflib") is None:
        raise PipelineError("Human3.6M's positions need the extra `evaluation`: pip install multicap[evaluation].")
    problems: list[Problem] = []
    videos = tuple(path for path in sorted((folder / _VIDEOS).glob("*.mp4")) if path.stem.rpartition(".")[0] == action)
    if has_footage and not videos:
        hint = "Give the folder of a subject, such as S9, or keypoints with --keypoints."
        message = f"There are no videos of the action in {_VIDEOS}."
        problems.append(Problem(DATASET_INCOMPLETE, message, file=f"{action}.*.mp4", hint=hint))
    path = folder / _POSES / f"{action}.cdf"
    truth_m = np.empty((0, 32, 3))
    try:
        (truth_m,) = read_truth(path, "human36m")
    except ValueError as error:
        known = [each.stem for each in sorted(path.parent.glob("*.cdf"))]
        hint = f"Give one of {listed_names(known)} by --action." if known else f"Unpack the positions into {_POSES}."
        message = f"The positions can't be read: {error}."
        problems.append(Problem(BENCHMARK_UNREADABLE, message, file=path.name, hint=hint))
    if problems:
        raise InputError(problems)
    return videos if has_footage else (), truth_m[:, _NUMBERS]


def score_human36m(
    tracks: Sequence[Track3D],
    joints: JointSet,
    timebase: Timebase,
    truth_m: Float[np.ndarray, "frames 13 3"],
    time_s: Mapping[int, float],
) -> dict[str, Any]:
    """Score tracks of COCO's joints at the frames that were reconstructed.

    ``time_s``: time of each frame by its number. The result has:

    - ``frames``: number of the compared frames.
    - ``mpjpe_mm``, ``pck150``, ``recall``, ``switches``, ``ghost_rate``: see ``evaluation.mpjpe``.
    - ``pa_mpjpe_mm``: mean error of the matched poses with all joints, each after the similarity with the least squares
      (Procrustes); ``None`` without such a pose.
    """
    numbers = np.array([number for number in range(len(truth_m)) if number in time_s], int)
    frames = np.rint((np.array([time_s[k] for k in numbers]) - timebase.start_time_s) * timebase.frame_rate_hz)
    inside = (frames >= 0) & (frames < timebase.num_frames)
    body_m = select_joints(tracks, joints, BODY_JOINTS, frames[inside].astype(int))
    predicted_m = np.concatenate([body_m, body_m[..., _HIPS, :].mean(-2, keepdims=True)], axis=-2)
    true_m = truth_m[numbers[inside]]
    (matched,) = match_frames(predicted_m, true_m[None])
    rows = np.flatnonzero(matched != UNMATCHED)
    poses = [(pose_m, true_m[row]) for row in rows if np.isfinite(pose_m := predicted_m[matched[row], row]).all()]
    aligned_m = [umeyama(pose_m, goal_m, has_scale=True).apply(pose_m) - goal_m for pose_m, goal_m in poses]
    return {
        "frames": len(true_m),
        **asdict(accuracy(predicted_m, true_m[None])),
        "pa_mpjpe_mm": 1000 * float(np.linalg.norm(aligned_m, axis=-1).mean()) if aligned_m else None,
    }
