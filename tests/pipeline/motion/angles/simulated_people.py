"""Simulated people who walk, squat and kick, with exact angles, and the angles of their fits."""

from functools import cache

import numpy as np

from pipeline.core.data.cameras import Timebase
from pipeline.core.joints import BODY_FEET
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.angles.compute import JointAngles, joint_angles, segment_angles
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.skeleton.animate import animate
from pipeline.validation.simulation.motion.performance import joints_at, perform, segments_at
from pipeline.validation.simulation.motion.script import Role, Turn, Walk
from tests.acrobatics.acrobat import acrobat_joints_at, acrobat_segments_at, perform_acrobatics
from tests.acrobatics.motions import ACROBATICS
from tests.pipeline.motion.skeleton.observed import observe, ring_of

RATE_HZ = 60.0
NOISE_PX = 3.0
_WALK = Role((-1.6, 0.0), 0.0, (Walk((1.6, 0.0)), Turn(np.pi), Walk((-1.6, 0.3))))


def performed(motion: str, seed: int, duration_s: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """True joints of ``BODY_FEET`` and true angles in degrees of a person; the first seconds of a motion, or all."""
    rng = np.random.default_rng(seed)
    if motion == "walk":
        time_s = np.arange(0.0, duration_s or 6.0, 1 / RATE_HZ)
        walker = perform(_WALK, 6.0, rng, BODY_FEET)
        joints_m, segments = joints_at(walker, time_s), segments_at(walker, time_s)
    else:
        keys = ACROBATICS[motion][0].keys
        time_s = np.arange(0.0, duration_s or keys[-1].time_s, 1 / RATE_HZ)
        acrobat = perform_acrobatics(keys, (0.0, 0.0), 0.5, keys[-1].time_s, rng)
        joints_m, segments = acrobat_joints_at(acrobat, time_s, BODY_FEET), acrobat_segments_at(acrobat, time_s)
    return joints_m, np.degrees(segment_angles(segments))


@cache
def fitted(motion: str, num_cameras: int, seed: int, duration_s: float | None = None) -> tuple[np.ndarray, JointAngles]:
    """True angles in degrees, and those of the fit to detections with 3 px of noise."""
    joints_m, truth_deg = performed(motion, seed, duration_s)
    cameras = ring_of(num_cameras)
    track, seen = observe(cameras, joints_m, noise_px=NOISE_PX, seed=seed)
    timebase = Timebase(0.0, RATE_HZ, len(joints_m))
    animation = animate([track], [seen], cameras, timebase, BODY_FEET, ReconstructionConfig())
    return truth_deg, joint_angles(animation.motions[0], animation.tracks[0], BODY_FEET)


def errors_deg(truth_deg: np.ndarray, angles: JointAngles) -> dict[str, np.ndarray]:
    """Errors of each kind of angle, both sides together, in frames in which it is known."""
    off_deg = angles.angle_deg - truth_deg
    off_deg -= 360.0 * np.round(off_deg / 360.0)
    errors: dict[str, list[np.ndarray]] = {}
    for column, name in enumerate(ANGLE_NAMES):
        known = np.isfinite(off_deg[:, column])
        errors.setdefault(job_kind(name), []).append(off_deg[known, column])
    return {name: np.concatenate(of_sides) for name, of_sides in errors.items()}


def job_kind(name: str) -> str:
    """Name of an angle without the side."""
    return name.removeprefix("left_").removeprefix("right_")


def rmse_deg(error_deg: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error_deg**2)))
