"""Truth in MATLAB's files: ``python -m ...datasets.read_truth KIND FILE``, a confined program.

The format is binary with compressed parts, and its readers trust the sizes that a file states.
"""

import sys
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy.io import loadmat

from pipeline.core.parsing import UnreadableError
from pipeline.core.runtime.confinement import (
    EXIT_OUT_OF_MEMORY,
    EXIT_REFUSED,
    BeyondLimitsError,
    ChildLimits,
    FileRefusedError,
    confined_arguments,
    run_confined,
    tell_ready,
)
from pipeline.core.runtime.npz import decode_arrays, encode_arrays

_PROGRAM = "pipeline.validation.evaluation.datasets.read_truth"
_LIMITS, _TIMEOUT_S = ChildLimits(cpu_s=60, memory_bytes=2**31), 90.0
_MAX_POSES = 1_000_000
_MAX_METRES = 1e3
_NUM_ACTOR_JOINTS = 14


def read_truth(path: Path, kind: str) -> np.ndarray:
    """Positions of people x frames x joints x 3 in metres, NaN where a person is not annotated; read in a child.

    ``kind``: name in ``READERS``. Raises ``UnreadableError`` with the reason.
    """
    if not path.is_file():
        raise UnreadableError("no file that can be opened")
    try:
        arguments, task = [kind, str(path.absolute())], f"reading of {path.name}"
        output = run_confined(_PROGRAM, arguments, _LIMITS, task=task, timeout_s=_TIMEOUT_S)
    except FileRefusedError as error:
        raise UnreadableError(str(error)) from None
    except BeyondLimitsError:
        raise UnreadableError("damaged, or larger than the limits on time and memory") from None
    return decode_arrays(output)["positions_m"]


def read_actors(path: str) -> np.ndarray:
    """Positions of ``actorsGT.mat``: a cell for each actor, with a cell of 14 x 3 metres for each image.

    Images without an annotation have a scalar, or an empty matrix.
    """
    cells = loadmat(path, variable_names=["actor3D"]).get("actor3D")
    if cells is None:
        raise UnreadableError("no variable actor3D")
    actors = [np.ravel(actor) for actor in np.ravel(cells)]
    num_images = max(map(len, actors), default=0)
    if not 0 < len(actors) * num_images <= _MAX_POSES:
        raise UnreadableError("actor3D has no poses, or more than a million")
    positions_m = np.full((len(actors), num_images, _NUM_ACTOR_JOINTS, 3), np.nan)
    for number, actor in enumerate(actors):
        for image, pose in enumerate(actor):
            if np.size(pose) <= 1:
                continue
            if np.shape(pose) != (_NUM_ACTOR_JOINTS, 3):
                raise UnreadableError(f"actor {number + 1} in image {image} is not a matrix of 14 x 3 numbers")
            positions_m[number, image] = pose
    return positions_m


READERS: Mapping[str, Callable[[str], np.ndarray]] = {"actors": read_actors}
"""Readers by kind of file."""


def _refuse(reason: str) -> NoReturn:
    sys.stderr.write(reason)
    sys.exit(EXIT_REFUSED)


def main() -> None:
    """Print the positions of a file."""
    kind, path = confined_arguments()
    warnings.simplefilter("ignore")
    tell_ready()
    try:
        positions_m = READERS[kind](path)
    except UnreadableError as error:
        _refuse(str(error))
    except MemoryError:
        sys.exit(EXIT_OUT_OF_MEMORY)
    except Exception:  # libraries raise undocumented exceptions
        _refuse("damaged, or in another format")
    if (np.abs(positions_m) > _MAX_METRES).any():
        _refuse("a position is kilometres away")
    sys.stdout.buffer.write(encode_arrays({"positions_m": positions_m}))


if __name__ == "__main__":
    main()
