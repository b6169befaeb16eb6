"""Truth in MATLAB's files and NASA's CDF: ``python -m ...datasets.read_truth KIND FILE``, a confined program.

Both are binary formats with compressed parts, whose readers trust the sizes that a file states.
"""

import sys
import warnings
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from pipeline.core.parsing import UnreadableError
from pipeline.core.runtime import confinement
from pipeline.core.runtime.npz import decode_arrays, encode_arrays

_PROGRAM = "pipeline.validation.evaluation.datasets.read_truth"
_LIMITS, _TIMEOUT_S = confinement.ChildLimits(cpu_s=60, memory_bytes=2**31), 90.0
_MAX_POSES = 1_000_000
_MAX_METRES = 1e3
_NUM_ACTOR_JOINTS, _NUM_HUMAN36M_JOINTS = 14, 32
_MILLIMETRE_M = 1e-3


def read_truth(path: Path, kind: str) -> np.ndarray:
    """Positions of people x frames x joints x 3 in metres, NaN where a person is not annotated; read in a child.

    ``kind``: ``actors`` or ``human36m``. Raises ``UnreadableError`` with the reason.
    """
    if not path.is_file():
        raise UnreadableError("no file that can be opened")
    arguments, task = [kind, str(path.absolute())], f"reading of {path.name}"
    try:
        output = confinement.run_confined(_PROGRAM, arguments, _LIMITS, task=task, timeout_s=_TIMEOUT_S)
    except confinement.FileRefusedError as error:
        raise UnreadableError(str(error)) from None
    except confinement.BeyondLimitsError:
        raise UnreadableError("damaged, or larger than the limits on time and memory") from None
    positions_m = decode_arrays(output)["positions_m"]
    if (np.abs(positions_m) > _MAX_METRES).any():
        raise UnreadableError("a position is kilometres away")
    return positions_m


def read_actors(path: str) -> np.ndarray:
    """Positions of ``actorsGT.mat``: a cell for each actor, with a cell of 14 x 3 metres for each image.

    Images without an annotation have a scalar, or an empty matrix.
    """
    actors = [np.ravel(actor) for actor in np.ravel(loadmat(path, variable_names=["actor3D"])["actor3D"])]
    num_images = max(map(len, actors), default=0)
    if not 0 < len(actors) * num_images <= _MAX_POSES:
        raise UnreadableError("actor3D has no poses, or more than a million")
    positions_m = np.full((len(actors), num_images, _NUM_ACTOR_JOINTS, 3), np.nan)
    for number, actor in enumerate(actors):
        for image, pose in enumerate(actor):
            if np.shape(pose) == (_NUM_ACTOR_JOINTS, 3):
                positions_m[number, image] = pose
            elif np.size(pose) > 1:
                raise UnreadableError(f"actor {number + 1} in image {image} is not a matrix of 14 x 3 numbers")
    return positions_m


def read_human36m(path: str) -> np.ndarray:
    """Positions of ``D3_Positions/ACTION.cdf``: the variable ``Pose``, 1 x frames x 96 millimetres."""
    from cdflib import CDF  # noqa: PLC0415 - an extra

    pose = np.asarray(CDF(path).varget("Pose"), np.float64)
    return _MILLIMETRE_M * pose.reshape(1, pose.shape[-2], _NUM_HUMAN36M_JOINTS, 3)


def main() -> None:
    """Print the positions of a file."""
    kind, path = confinement.confined_arguments()
    warnings.simplefilter("ignore")
    confinement.tell_ready()
    try:
        read = read_actors if kind == "actors" else read_human36m
        sys.stdout.buffer.write(encode_arrays({"positions_m": read(path)}))
    except MemoryError:
        sys.exit(confinement.EXIT_OUT_OF_MEMORY)
    except Exception as error:  # libraries raise undocumented exceptions
        sys.stderr.write(str(error) if isinstance(error, UnreadableError) else "damaged, or in another format")
        sys.exit(confinement.EXIT_REFUSED)


if __name__ == "__main__":
    main()
