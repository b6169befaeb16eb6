"""Read a file of 3D points: ``python -m pipeline.capture.point_files.read_points FILE``, a confined program."""

import json
import sys
import warnings
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.capture.point_files import readers
from pipeline.capture.point_files.point_reader import PointReader, PointTable
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.config import MAX_OUTPUT_FRAMES
from pipeline.core.problems.session_codes import KEYPOINTS_UNREADABLE
from pipeline.core.runtime.confinement import (
    BeyondLimitsError,
    ChildLimits,
    confined_arguments,
    run_confined,
    tell_ready,
)
from pipeline.core.runtime.npz import decode_arrays, encode_arrays
from pipeline.core.runtime.plugins import load_readers

_PROGRAM = "pipeline.capture.point_files.read_points"
_LIMITS, _TIMEOUT_S = ChildLimits(cpu_s=120), 150.0


@cache
def point_readers() -> tuple[PointReader, ...]:
    """Readers of other packages, then this one's."""
    return load_readers(PointReader, readers)


def read_table(path: Path) -> tuple[PointTable, str]:
    """Points of a file or folder and the name of its format, read in a child; raises ``InputError``."""
    suffix = "" if path.is_dir() else path.suffix.lower()
    reader = next((each for each in point_readers() if suffix in each.suffixes), None)
    known = ", ".join(sorted(suffix for each in point_readers() for suffix in each.suffixes if suffix))
    if reader is None or not path.exists() or path.is_dir() != (suffix == ""):
        message = "The file does not exist." if reader else f"Files of 3D points end with {known}."
        raise _refusal(path, message)
    try:
        arguments, task = [str(path.absolute()), reader.name], f"reading of {path.name}"
        output = run_confined(_PROGRAM, arguments, _LIMITS, task=task, timeout_s=_TIMEOUT_S)
    except BeyondLimitsError:
        raise _refusal(path, "The file can't be read within the limits on time and memory.") from None
    arrays = decode_arrays(output)
    head = json.loads(str(arrays["head"]))
    if "problem" in head:
        raise _refusal(path, head["problem"] or f"The file is damaged, or not in the format {reader.name}.")
    turns = {label: arrays[f"turn_{k}"] for k, label in enumerate(head.pop("turns"))}
    fields = head | {"names": tuple(head["names"]), "world_from_segment": turns}
    return PointTable(xyz=arrays["xyz"], **fields), reader.name


def _refusal(path: Path, message: str) -> InputError:
    return InputError([Problem(KEYPOINTS_UNREADABLE, message, file=path.name)])


def answer(path: Path, name: str) -> bytes:
    """Encoded table of a file, or its problem."""
    try:
        table = next(reader for reader in point_readers() if reader.name == name).read(path)
        xyz = np.where(np.isfinite(table.xyz), table.xyz, np.nan).astype(np.float64)
        fields = ("names", "rate_hz", "unit", "up", "start_s")
        turns = table.world_from_segment
        head = json.dumps({field: getattr(table, field) for field in fields} | {"turns": list(turns)})
        if xyz.shape[1:] == (len(table.names), 3) and 0 < len(xyz) <= MAX_OUTPUT_FRAMES and abs(table.start_s) < 1e7:
            arrays = {f"turn_{k}": nearest_rotations(of, len(xyz)) for k, of in enumerate(turns.values())}
            return encode_arrays({"head": np.array(head), "xyz": xyz, **arrays})
        message: str | None = f"The file has no frames, more than {MAX_OUTPUT_FRAMES:,}, or points without names."
    except KeypointsError as error:
        message = str(error)
    except MemoryError:
        message = "The file needs more memory than a file may."
    except Exception:
        message = None
    return encode_arrays({"head": np.array(json.dumps({"problem": message}))})


def nearest_rotations(matrices: Float[np.ndarray, "rows 3 3"], num_frames: int) -> Float[np.ndarray, "frames 3 3"]:
    """Rotations nearest to matrices, NaN where one is not a rotation within 0.01, or missing."""
    turns = np.full((num_frames, 3, 3), np.nan)
    turns[: len(matrices)] = matrices[:num_frames]
    with np.errstate(all="ignore"):
        product = np.swapaxes(turns, -1, -2) @ turns
        good = (np.abs(product - np.eye(3)) < 0.01).all((-1, -2)) & (np.linalg.det(turns) > 0)
    turns[~good] = np.nan
    turns[good] = Rotation.from_matrix(turns[good]).as_matrix() if good.any() else turns[good]
    return turns


def main() -> None:
    """Print the answer about the file."""
    path, name = confined_arguments()
    warnings.simplefilter("ignore")
    tell_ready()
    sys.stdout.buffer.write(answer(Path(path), name))


if __name__ == "__main__":
    main()
