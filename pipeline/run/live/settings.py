"""Settings of a live capture, and bones of people of an earlier take for its setting ``bodies``."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import JointSet
from pipeline.core.options.arguments import checked
from pipeline.core.parsing import UnreadableError, read_json
from pipeline.core.paths import StrPath
from pipeline.core.problems.finding_codes import PARAMETER_RANGE
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.skeleton import learn_bones

MAX_BODIES, MAX_BONE_M = 32, 2.0
"""Largest number of people of earlier takes, and largest length of a bone of theirs in metres."""

SAME_INSTANT = 1e-3
"""Part of a period by which the times of frames that show the same instant may differ."""

_LIMITS = {
    "frame_rate_hz": (1.0, 1000.0),
    "output_rate_hz": (0.1, 1000.0),
    "window_s": (0.001, 10.0),
    "learn_s": (0.2, 60.0),
}


@dataclass(frozen=True, slots=True)
class LiveSettings:
    """Settings of a live capture.

    Parameters
    ----------
    frame_rate_hz
        Rate of the cameras; of the fastest, if they differ.
    output_rate_hz
        Rate of the instants; ``None``: the cameras' rate.
    window_s
        Longest time that a frame waits for earlier frames of other cameras. An instant is final as soon as all cameras
        have sent a frame at or behind it, and at the latest when the newest frame is this long behind it.
    is_ordered
        Whether the frames of each camera come in their order. If not, every frame waits for ``window_s``.
    learn_s
        Time in sight after which a person's bones are learnt.
    bodies
        Lengths of bones of people of earlier takes, in metres, in the order of the skeleton's joints. These people have
        the first numbers, in this order, and need no learning once they are recognised by their proportions.

    Raises
    ------
    InputError
        If a value is not allowed; it names all of them.

    Examples
    --------
    >>> LiveSettings(50.0, output_rate_hz=25.0).output_rate_hz
    25.0
    """

    frame_rate_hz: float
    output_rate_hz: float | None = None
    window_s: float = 0.1
    is_ordered: bool = True
    learn_s: float = 3.0
    bodies: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if problems := tuple(self._problems()):
            raise InputError(problems)

    @property
    def instants_hz(self) -> float:
        """Rate of the instants."""
        return self.frame_rate_hz if self.output_rate_hz is None else self.output_rate_hz

    @property
    def same_instant_s(self) -> float:
        """Difference of the times of frames that show the same instant."""
        return SAME_INSTANT / self.frame_rate_hz

    def _problems(self) -> Iterator[Problem]:
        for name, (lowest, highest) in _LIMITS.items():
            value = getattr(self, name)
            if value is None and name == "output_rate_hz":
                continue
            if not (isinstance(value, int | float) and math.isfinite(value) and lowest <= value <= highest):
                message = f"{name} must be a number from {lowest:g} to {highest:g}."
                yield Problem(PARAMETER_RANGE, message, field=name)
        if len(self.bodies) > MAX_BODIES:
            yield Problem(PARAMETER_RANGE, f"bodies must be of at most {MAX_BODIES} people.", field="bodies")
        for number, lengths_m in enumerate(self.bodies[:MAX_BODIES], 1):
            if len(lengths_m) != len(SKELETON) or not all(0.0 <= length_m <= MAX_BONE_M for length_m in lengths_m):
                message = f"Body {number} must have {len(SKELETON)} lengths of bones, from 0 to {MAX_BONE_M:g} metres."
                yield Problem(PARAMETER_RANGE, message, field="bodies")


# Frames from which lengths are learnt, evenly spaced over the take.
_MOST_FRAMES = 400


@checked
def read_bodies(path: StrPath) -> tuple[tuple[float, ...], ...]:
    """Lengths of the skeleton's bones, in metres, of each person of a result file ``skeletons.json``.

    Parameters
    ----------
    path
        Result file ``skeletons.json``.

    Returns
    -------
    tuple of tuples
        Lengths in metres, in the order of the skeleton's joints, of each person.

    Raises
    ------
    InputError
        If the file can't be read.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> written = multicap.reconstruct_to_files(session, folder / "earlier")
    >>> bodies = read_bodies(folder / "earlier" / "skeletons.json")
    >>> len(bodies) == len(written.metrics["people"])
    True
    """
    path = Path(path)
    try:
        content = read_json(path.read_bytes())
        joints = JointSet(tuple(content["joint_names"]), ())
        tracks_m = [_positions_m(track["positions_m"], len(joints.names)) for track in content["tracks"]]
    except (OSError, UnreadableError, KeyError, TypeError, ValueError):
        message = "The file is not the skeletons.json of a result."
        hint = "Give the file skeletons.json of an earlier reconstruction."
        raise InputError([Problem(PARAMETER_RANGE, message, file=path.name, hint=hint)]) from None
    return tuple(tuple(learn_bones(track_m, joints).length_m.tolist()) for track_m in tracks_m)


def _positions_m(rows: list[list[list[float] | None]], num_joints: int) -> Float[np.ndarray, "frames joints 3"]:
    kept = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_FRAMES)).round().astype(int))
    nowhere = [np.nan] * 3
    values = [[nowhere if point is None else point for point in rows[row]] for row in kept.tolist()]
    return np.array(values, np.float64).reshape(len(kept), num_joints, 3)
