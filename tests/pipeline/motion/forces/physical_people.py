"""Simulated people whose centre of mass moves as forces of limited size move it, with these forces.

Simulated joints follow poses, not forces: the body above the feet is shifted so that its centre of mass has a path
without kinks, which falls freely in flights. The force of the ground is then known exactly. Feet stay where they stand:
if they were shifted too, they would rise before a take-off and sink after a landing.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from pipeline.capture.points import unseen
from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.reconstruction import Subject
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.balance.segment_masses import segment_masses
from pipeline.motion.forces.person_forces import PersonForces, forces_of
from pipeline.motion.forces.smoothing import PathSmoother, penalty_of
from pipeline.motion.skeleton.animate import animate
from pipeline.validation.simulation.motion.performance import joints_at
from tests.pipeline.motion.gait.walks import Act, exact, performed
from tests.pipeline.motion.skeleton.observed import observe, ring_of

FINE_HZ = 1000.0
# Highest frequencies of the true forces, of acts with flights and of others: simulated steps are stiffer than people's,
# whose force is within 70 to 130 % of their weight in a walk.
FORCE_HZ = {True: 6.0, False: 3.5}
# Share of the body's shift that joints of the legs have.
SHIFTED = {"knee": 0.5, "ankle": 0.0, "heel": 0.0, "toe": 0.0}


class Truth(NamedTuple):
    """True motion of a person at the frames of the act."""

    xyz_m: np.ndarray
    force: np.ndarray  # Of the ground for each kilogram, mean over a frame
    flies: np.ndarray
    heights_m: list[float]  # Rise of the centre of mass in each flight


@cache
def truth_of(act: Act) -> Truth:
    time_s = np.arange(round(act.duration_s * FINE_HZ)) / FINE_HZ
    person = performed(act)
    joints_m = joints_at(person, time_s)
    masses = segment_masses(Subject(), act.joints)
    assert masses is not None
    centre_m = np.einsum("j,fjk->fk", masses.weights, joints_m)
    assert person.hop_m is not None
    hop_m = np.interp(time_s, np.linspace(0.0, time_s[-1], len(person.hop_m)), person.hop_m)
    flies = hop_m > 0.0005
    smoother = PathSmoother(np.ones(len(time_s), bool), penalty_of(FORCE_HZ[bool(flies.any())], FINE_HZ), FINE_HZ)
    path_m = smoother.path_with_falls(centre_m, 0.1, flies)
    shifted = np.array([next((share for kind, share in SHIFTED.items() if kind in n), 1.0) for n in act.joints.names])
    joints_m += (path_m - centre_m)[:, None] * (shifted / (masses.weights @ shifted))[:, None]
    force = smoother.acceleration(path_m) + np.array([0.0, 0.0, GRAVITY_M_S2])
    rows = (np.arange(0.0, act.duration_s - 1.0 / act.rate_hz, 1.0 / act.rate_hz) * FINE_HZ).round().astype(int)
    half = round(FINE_HZ / act.rate_hz / 2)
    summed = np.cumsum(np.concatenate([np.zeros((1, 3)), force]), axis=0)
    first, last = np.maximum(rows - half, 0), np.minimum(rows + half, len(force))
    mean = (summed[last] - summed[first]) / (last - first)[:, None]
    edges = np.flatnonzero(np.diff(flies.astype(int), prepend=0, append=0)).reshape(-1, 2)
    heights_m = [float(path_m[start:stop, 2].max() - path_m[start, 2]) for start, stop in edges]
    return Truth(joints_m[rows], mean, flies[rows], heights_m)


@cache
def animated(act: Act) -> Animation:
    """Fit of an act, seen by cameras."""
    cameras, truth = ring_of(act.num_cameras), truth_of(act)
    track, seen = observe(cameras, truth.xyz_m, noise_px=act.noise_px, seed=act.seed)
    timebase = Timebase(0.0, act.rate_hz, len(truth.xyz_m))
    return animate([track], [seen], cameras, timebase, act.joints, ReconstructionConfig())


@cache
def solved(act: Act) -> Animation:
    """Skeleton of an act whose joints are exactly known, as from a system of markers."""
    track = exact(truth_of(act).xyz_m)
    timebase = Timebase(0.0, act.rate_hz, track.num_frames)
    return animate([track], [unseen(track)], (), timebase, act.joints, ReconstructionConfig())


def estimated(act: Act, mass_kg: float | None = None, **more: Any) -> PersonForces:
    """Forces of an act: of its fit, or of its exact joints without cameras; in newtons with a mass."""
    animation = animated(act) if act.num_cameras else solved(act)
    subject = Subject(mass_kg=mass_kg)
    forces = forces_of(animation.motions[0], animation.tracks[0], act.joints, subject, animation.floor, **more)
    assert forces is not None
    return forces if mass_kg is None else forces.in_newtons()
