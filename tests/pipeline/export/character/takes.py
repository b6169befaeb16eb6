"""Animations of simulated people, for tests of characters."""

from dataclasses import replace
from functools import cache

import numpy as np

from pipeline.core.data.animation import Animation
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.skeleton.animate import animate
from pipeline.validation.simulation.scenes import Joints, record
from tests.acrobatics.scenes import ALL_SCENES
from tests.pipeline.motion.skeleton.observed import observe, ring_of


@cache
def take_of(scene: str, joints: Joints, duration_s: float) -> Animation:
    """Animation of the first person of a scene, whose joints are seen exactly."""
    simulation = record(ALL_SCENES[scene], 1, joints=joints)
    frames = slice(0, round(duration_s * simulation.timebase.frame_rate_hz))
    truth_m = simulation.truth_m[0, frames]
    is_there = np.isfinite(truth_m).all((1, 2))
    cameras = ring_of(5)
    track, observations = observe(cameras, truth_m[is_there])
    timebase = replace(simulation.timebase, num_frames=track.num_frames)
    return animate([track], [observations], cameras, timebase, simulation.joints, ReconstructionConfig())
