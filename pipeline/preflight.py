"""Check a session in a process of its own: ``python -m pipeline.preflight --videos FILE... --calibration FILE``.

Prints one JSON object: ``{"problems": [...]}`` with exit code 2, or what the session is. So a caller that must not load
the science, or must not be hurt by a stranger's file, can still know all about a session. ``--record FILE`` keeps what
was found, so that nobody has to look through the videos again.
"""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.errors import InputError
from pipeline.records_npz import encode_session
from pipeline.session import CaptureSession, open_session

EXIT_BAD_INPUT = 2


def report(session: CaptureSession) -> dict[str, Any]:
    """Cameras with their videos, the shared clock, and warnings."""
    return {
        "cameras": [
            {
                "name": camera.name,
                "file": video.path.name,
                "size_px": list(camera.size_px),
                "frame_rate_hz": video.frame_rate_hz,
                "num_frames": video.num_frames,
            }
            for camera, video in zip(session.cameras, session.videos, strict=True)
        ],
        "timebase": asdict(session.timebase),
        "warnings": list(session.warnings),
    }


def main() -> int:
    """Run the check and return the exit code."""
    parser = argparse.ArgumentParser(description="Check a capture session.")
    parser.add_argument("--videos", nargs="+", type=Path, required=True)
    parser.add_argument("--calibration", type=Path, required=True)
    parser.add_argument("--record", type=Path)
    arguments = parser.parse_args()
    try:
        session = open_session(arguments.videos, arguments.calibration)
        if arguments.record:
            arguments.record.write_bytes(encode_session(session))
        found = report(session)
    except InputError as error:
        found = {"problems": [asdict(problem) for problem in error.problems]}
    sys.stdout.write(json.dumps(found, allow_nan=False) + "\n")
    return EXIT_BAD_INPUT if "problems" in found else 0


if __name__ == "__main__":
    sys.exit(main())
