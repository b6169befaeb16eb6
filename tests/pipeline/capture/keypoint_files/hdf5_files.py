"""Answer of the child process for each HDF5 file of a folder, without the start of a process for each."""

import json
import os
import sys
from pathlib import Path

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.capture.keypoint_files.read_hdf5 import answer
from pipeline.capture.keypoint_files.readers.hdf5 import decoded
from pipeline.core.parsing import UnreadableError
from pipeline.core.runtime.confinement import ChildLimits, confine, is_caused_by_file


def ending(path: Path) -> str:
    """How a child ends that reads a file: with people, a problem, or at a limit."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        confine(ChildLimits(cpu_s=30))
        with os.fdopen(writing, "wb") as pipe:
            pipe.write(answer(path))
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        content = pipe.read()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code:
        return "limit" if is_caused_by_file(code) else f"exit code {code}"
    try:
        decoded(content)
    except (KeypointsError, UnreadableError):
        return "problem"
    return "read"


if __name__ == "__main__":
    json.dump([ending(path) for path in sorted(Path(sys.argv[1]).glob("*.h5"))], sys.stdout)
