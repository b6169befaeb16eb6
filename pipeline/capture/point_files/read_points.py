"""Read a file of 3D points: ``python -m pipeline.capture.point_files.read_points FILE``, a confined program."""

import json
import sys
import warnings
from functools import cache
from pathlib import Path

import numpy as np

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
    reader = next((each for each in point_readers() if path.suffix.lower() in each.suffixes), None)
    known = ", ".join(sorted(suffix for each in point_readers() for suffix in each.suffixes if suffix))
    if reader is None or not path.exists() or path.is_dir() != (path.suffix == ""):
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
    return PointTable(xyz=arrays["xyz"], **head | {"names": tuple(head["names"])}), reader.name


def _refusal(path: Path, message: str) -> InputError:
    return InputError([Problem(KEYPOINTS_UNREADABLE, message, file=path.name)])


def answer(path: Path, name: str) -> bytes:
    """Encoded table of a file, or its problem."""
    try:
        table = next(reader for reader in point_readers() if reader.name == name).read(path)
        xyz = np.where(np.isfinite(table.xyz), table.xyz, np.nan).astype(np.float64)
        fields = ("names", "rate_hz", "unit", "up", "start_s")
        head = json.dumps({field: getattr(table, field) for field in fields})
        if xyz.shape[1:] == (len(table.names), 3) and 0 < len(xyz) <= MAX_OUTPUT_FRAMES and abs(table.start_s) < 1e7:
            return encode_arrays({"head": np.array(head), "xyz": xyz})
        message: str | None = f"The file has no frames, more than {MAX_OUTPUT_FRAMES:,}, or points without names."
    except KeypointsError as error:
        message = str(error)
    except MemoryError:
        message = "The file needs more memory than a file may."
    except Exception:
        message = None
    return encode_arrays({"head": np.array(json.dumps({"problem": message}))})


def main() -> None:
    """Print the answer about the file."""
    path, name = confined_arguments()
    warnings.simplefilter("ignore")
    tell_ready()
    sys.stdout.buffer.write(answer(Path(path), name))


if __name__ == "__main__":
    main()
