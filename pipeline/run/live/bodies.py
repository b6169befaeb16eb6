"""Bones of people of an earlier take, for the setting ``bodies`` of a live capture."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import JointSet
from pipeline.core.parsing import UnreadableError, read_json
from pipeline.core.paths import StrPath
from pipeline.core.problems.findings import PARAMETER_RANGE
from pipeline.run.live.skeleton import learn_bones

# Frames from which lengths are learnt, evenly spaced over the take.
_MOST_FRAMES = 400


def read_bodies(path: StrPath) -> tuple[tuple[float, ...], ...]:
    """Lengths of the skeleton's bones, in metres, of each person of a result file ``skeletons.json``.

    Raises
    ------
    InputError
        If the file can't be read.
    """
    path = Path(path)
    try:
        content = read_json(path.read_bytes())
        joints = JointSet(tuple(content["joint_names"]), ())
        tracks_m = [_positions_m(track["positions_m"], len(joints.names)) for track in content["tracks"]]
    except (OSError, UnreadableError, KeyError, TypeError, ValueError):
        message = "The file is no skeletons.json of a result."
        hint = "Give the file skeletons.json of an earlier reconstruction."
        raise InputError([Problem(PARAMETER_RANGE, message, file=path.name, hint=hint)]) from None
    return tuple(tuple(learn_bones(track_m, joints).length_m.tolist()) for track_m in tracks_m)


def _positions_m(rows: list[list[list[float] | None]], num_joints: int) -> Float[np.ndarray, "frames joints 3"]:
    kept = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_FRAMES)).round().astype(int))
    nowhere = [np.nan] * 3
    values = [[nowhere if point is None else point for point in rows[row]] for row in kept.tolist()]
    return np.array(values, np.float64).reshape(len(kept), num_joints, 3)
