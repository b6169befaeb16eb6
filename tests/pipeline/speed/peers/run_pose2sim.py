"""Associate and triangulate several people by Pose2Sim: ``PROJECT OUT RATE_HZ``, in a folder as Pose2Sim wants it."""

import logging
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
import rtoml
from Pose2Sim import common, personAssociation, triangulation

# Parameters of its demo of several people, in `Pose2Sim/Demo_MultiPerson/Config.toml` of the package.
DEMO = Path(common.__file__).parent / "Demo_MultiPerson" / "Config.toml"


def main(project: Path, out: Path, rate_hz: float) -> None:
    """Write positions in metres, their frames, the names of the joints, and the seconds of a core."""
    logging.disable(logging.ERROR)
    config = rtoml.load(DEMO)
    config["project"] |= {
        "project_dir": str(project),
        "multi_person": True,
        "frame_rate": rate_hz,
        "frame_range": "all",
    }
    config["pose"]["pose_model"] = "COCO_17"
    config["triangulation"] |= {"undistort_points": True, "make_c3d": False}
    started_s = core_s()
    personAssociation.associate_all(config)
    triangulation.triangulate_all(config)
    ended_s = core_s()
    people = [common.read_trc(str(path)) for path in sorted((project / "pose-3d").glob("*.trc"))]
    content: dict[str, Any] = {"core_s": np.array(ended_s - started_s)}
    for number, (positions, frames, _, _, _) in enumerate(people):
        # Columns of a joint in the file are y, z and x of the world.
        content[f"xyz_m_{number}"] = np.asarray(positions).reshape(len(frames), -1, 3)[:, :, [2, 0, 1]]
        content[f"frames_{number}"] = np.asarray(frames, int)
    content["names"] = np.array([name for name in people[0][3] if name])
    np.savez(out, **content)


def core_s() -> float:
    """Seconds of a core that this process has taken."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))
