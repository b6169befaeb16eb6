"""Read an HDF5 file of 2D points: ``python -m pipeline.capture.keypoint_files.hdf5.read FILE``, a confined program.

It prints what ``tracks.decoded`` reads.
"""

import sys
from pathlib import Path

from pipeline.capture.keypoint_files.hdf5 import deeplabcut_tables, sleap_analysis
from pipeline.capture.keypoint_files.hdf5.nodes import names_in, opened
from pipeline.capture.keypoint_files.hdf5.tracks import Tracks, encoded, problem
from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.core.runtime.confinement import confined_arguments, tell_ready

_PROJECT = {"instances", "pred_points", "points"}
_PROJECT_ADVICE = (
    "The file is SLEAP's project. Give its analysis file, which is read: Export Analysis HDF5 in SLEAP's menu, "
    "sleap-convert --format analysis, or save_analysis_h5 of sleap-io."
)


def read(path: Path) -> Tracks:
    """Read a file; raises ``KeypointsError`` for other contents, and all kinds of exceptions if it is damaged."""
    with opened(path) as file:
        if sleap_analysis.is_analysis(file):
            return sleap_analysis.read(file)
        if (table := deeplabcut_tables.table_of(file)) is not None:
            return deeplabcut_tables.read(table)
        names = names_in(file)
        if set(names) >= _PROJECT:
            raise KeypointsError(_PROJECT_ADVICE)
        shown = ", ".join(name[:40] for name in names[:5]) or "nothing"
    raise KeypointsError(f"The HDF5 file has neither DeepLabCut's table nor SLEAP's tracks; it has {shown}.")


def answer(path: Path) -> bytes:
    """Encoded tracks of a file, or its problem."""
    try:
        return encoded(read(path))
    except KeypointsError as error:
        return problem(str(error), error.field)
    except MemoryError:
        return problem("The HDF5 file needs more memory than a file may.")
    except Exception:  # HDF5 and h5py raise all kinds of exceptions for a damaged file
        return problem(None)


def main() -> None:
    """Print the answer about the file."""
    (path,) = confined_arguments()
    tell_ready()
    sys.stdout.buffer.write(answer(Path(path)))


if __name__ == "__main__":
    main()
