"""Scale a model and run its inverse kinematics: ``python -m pipeline.export.opensim.child FOLDER``, a confined program.

The folder has the files of ``setup``. OpenSim needs no network. It writes its log to stdout, which the parent
reads; the last line of stderr is the error of a step that failed, as JSON.
"""

import json
import os
import sys

from pipeline.core.runtime.confinement import EXIT_REFUSED, confined_arguments, tell_ready

STEPS = ("scale.xml", "ik.xml")
"""Setups in the order in which they are run."""


def main() -> None:
    """Run both steps in the folder."""
    (folder,) = confined_arguments()
    os.chdir(folder)
    import opensim  # noqa: PLC0415 - loaded in the folder, so that a log which it begins lies there

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Info")
    tell_ready()
    for setup, tool in zip(STEPS, (opensim.ScaleTool, opensim.InverseKinematicsTool), strict=True):
        try:
            tool(setup).run()
        except RuntimeError as error:
            print(json.dumps({"setup": setup, "error": str(error)}), file=sys.stderr, flush=True)  # noqa: T201
            sys.exit(EXIT_REFUSED)


if __name__ == "__main__":
    main()
