"""Simulated walks and exercises with exact truth, as exact tracks or as fits of noisy observations."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import BODY_FEET, COCO_17, JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.gait.analysis import PersonGait, analyse_gait
from pipeline.motion.skeleton.animate import animate
from pipeline.validation.simulation.motion.performance import SimulatedPerson, joints_at, perform
from pipeline.validation.simulation.motion.script import Cue, Gesture, Role, Stay, Walk
from tests.pipeline.motion.skeleton.observed import observe, ring_of

HALF_WAY_M = 2.8


@dataclass(frozen=True)
class Act:
    """Act of a simulated person, and what makes a track of it."""

    cues: tuple[Cue, ...]
    start_m: tuple[float, float] = (0.0, 0.0)
    facing_rad: float = 0.0
    duration_s: float = 8.0
    seed: int = 1
    rate_hz: float = 60.0
    num_cameras: int = 0  # 0: the track is exact
    noise_px: float = 3.0
    joints: JointSet = BODY_FEET
    belt_m_s: float = 0.0  # Speed along -X with which everything moves from the middle of the act on
    rows: tuple[int, int] | None = None  # Frames of the take; ``None``: all


def walk(
    speed_m_s: float, seed: int = 1, rate_hz: float = 60.0, num_cameras: int = 0, joints: JointSet = BODY_FEET
) -> Act:
    """Walk across the middle of the cameras, from rest to rest."""
    cues = Stay(0.6), Walk((HALF_WAY_M, -0.3), speed_m_s), Stay(0.6)
    duration_s = 2 * HALF_WAY_M / speed_m_s + 2.2
    return Act(cues, (-HALF_WAY_M, 0.3), 0.0, duration_s, seed, rate_hz, num_cameras, joints=joints)


def exercise(gesture: Gesture, seed: int = 1, num_cameras: int = 0, joints: JointSet = BODY_FEET) -> Act:
    """Exercise in the middle of the cameras."""
    return Act((Stay(7.4, gesture),), (0.2, 0.0), 0.4, 7.8, seed, num_cameras=num_cameras, joints=joints)


def treadmill(speed_m_s: float, seed: int = 1, num_cameras: int = 0, rate_hz: float = 60.0) -> tuple[Act, float]:
    """Steady walk on a belt of 10 s, and the belt's true speed."""
    far_m = 6.0 * speed_m_s
    act = Act((Walk((far_m, 0.0), speed_m_s),), (-far_m, 0.0), 0.0, 12.6, seed, rate_hz, num_cameras)
    person = performed(act)
    start, stop = round(2 * rate_hz), round(10.6 * rate_hz)
    x_m = joints_at(person, np.array([start, stop]) / rate_hz)[:, BODY_FEET.index("left_hip"), 0]
    belt_m_s = float(x_m[1] - x_m[0]) / (stop - start) * rate_hz
    return Act(**{**vars(act), "belt_m_s": belt_m_s, "rows": (round(1.2 * rate_hz), round(11.4 * rate_hz))}), belt_m_s


@cache
def performed(act: Act) -> SimulatedPerson:
    """Person of an act."""
    role = Role(act.start_m, act.facing_rad, act.cues)
    return perform(role, act.duration_s, np.random.default_rng(act.seed), act.joints)


def exact(xyz_m: np.ndarray) -> Track3D:
    """Track whose joints are exactly measured."""
    shape = xyz_m.shape[:2]
    return Track3D(
        1, 0, xyz_m, np.ones(shape), np.full(shape, Source.MEASURED, np.int8), np.zeros(shape), np.full(shape, 4)
    )


@cache
def track_of(act: Act) -> Track3D:
    """Track of an act, exact or fitted."""
    time_s = np.arange(0.0, act.duration_s, 1 / act.rate_hz)
    xyz_m = joints_at(performed(act), time_s)
    xyz_m[..., 0] -= act.belt_m_s * (time_s - act.duration_s / 2)[:, None]
    if act.rows is not None:
        xyz_m = xyz_m[slice(*act.rows)]
    if act.num_cameras == 0:
        return exact(xyz_m)
    cameras = ring_of(act.num_cameras)
    track, seen = observe(cameras, xyz_m, noise_px=act.noise_px, seed=act.seed)
    timebase = Timebase(0.0, act.rate_hz, len(xyz_m))
    return animate([track], [seen], cameras, timebase, act.joints, ReconstructionConfig()).tracks[0]


@cache
def gait_of(act: Act) -> PersonGait:
    """Gait and movements of an act's track."""
    return analyse_gait(track_of(act), act.joints, act.rate_hz)


def body_only(act: Act) -> Act:
    """Same act of a person without heels and toes."""
    return Act(**{**vars(act), "joints": COCO_17})
