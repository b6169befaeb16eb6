"""Scale a model and run its inverse kinematics: ``python -m pipeline.export.opensim.child FOLDER CPU_S``.

The folder has the files of ``setup``. The process has limits on memory, computing time and the size of what it
writes, and needs no network. OpenSim writes its log to stdout, which the parent reads; the last line of stderr is the
error of a step that failed, as JSON.
"""

import json
import os
import resource
import sys
from pathlib import Path

STEPS = ("scale.xml", "ik.xml")
"""Setups in the order in which they are run."""
EXIT_FAILED = 3
"""Exit code if OpenSim fails; everything else that ends the process is not its doing."""
READY = "multicap: ready"
"""Line of the log before OpenSim opens the first file."""

_MAX_MEMORY_BYTES = 4 * 2**30
_MAX_FILE_BYTES = 2**31
_MAX_OPEN_FILES = 256


def main() -> None:
    """Run both steps in the folder."""
    folder, max_cpu_s = Path(sys.argv[1]), int(sys.argv[2])
    os.chdir(folder)
    _limit(max_cpu_s)
    import opensim  # noqa: PLC0415 - loaded in the folder, so that a log which it begins lies there

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Info")
    print(READY, flush=True)  # noqa: T201 - read by the parent
    for setup, tool in zip(STEPS, (opensim.ScaleTool, opensim.InverseKinematicsTool), strict=True):
        try:
            tool(setup).run()
        except RuntimeError as error:
            print(json.dumps({"setup": setup, "error": str(error)}), file=sys.stderr, flush=True)  # noqa: T201
            sys.exit(EXIT_FAILED)


def _limit(max_cpu_s: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MAX_MEMORY_BYTES, _MAX_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (max_cpu_s, max_cpu_s + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_MAX_FILE_BYTES, _MAX_FILE_BYTES))
    resource.setrlimit(resource.RLIMIT_NOFILE, (_MAX_OPEN_FILES, _MAX_OPEN_FILES))


if __name__ == "__main__":
    main()
