"""Read an HDF5 file of 2D points in a child process (``hdf5.read``) with limits on memory and time."""

import subprocess
from pathlib import Path

from pipeline.capture.keypoint_files.hdf5.tracks import PeopleByFrame, decoded
from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.core.runtime.child_processes import module_command
from pipeline.video.children import READY, child_environment, child_error, is_caused_by_file

# Far above the second or two of a file of the largest size.
_MAX_CPU_S = 60
_TIMEOUT_S = 4.0 * _MAX_CPU_S


def read_in_child(path: Path) -> PeopleByFrame:
    """Read a file; one that makes HDF5 crash, hang or exhaust memory ends only its child.

    Raises ``KeypointsError`` if the file can't be used, ``UnreadableError`` if it is damaged, and ``ChildError`` if the
    child fails for a reason other than its file.
    """
    command = module_command("pipeline.capture.keypoint_files.hdf5.read", str(path.absolute()), str(_MAX_CPU_S))
    try:
        child = subprocess.run(  # noqa: S603 - our own interpreter and module
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=False,
            env=child_environment(),
        )
    except subprocess.TimeoutExpired:
        raise _beyond_limits() from None
    if is_caused_by_file(child.returncode):
        raise _beyond_limits()
    if child.returncode or not child.stdout.startswith(READY):
        errors = child.stderr.decode(errors="replace")
        raise child_error(f"reading of {path.name}", child.returncode, _TIMEOUT_S, errors)
    return decoded(child.stdout.removeprefix(READY))


def _beyond_limits() -> KeypointsError:
    return KeypointsError("The HDF5 file can't be read within the limits on time and memory.")
