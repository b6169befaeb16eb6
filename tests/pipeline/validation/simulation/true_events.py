"""True events of simulated people: foot strikes and foot offs of their steps, and flights of their jumps."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.validation.simulation.motion.locomotion import GRID_HZ, Steps
from pipeline.validation.simulation.motion.performance import SimulatedPerson

# Height of the feet above the floor from which on a person flies.
_LEAST_HOP_M = 1e-9


class StepTimes(NamedTuple):
    """Times of a foot's steps, in seconds from the start of the motion."""

    strikes_s: Float[np.ndarray, " strikes"]
    offs_s: Float[np.ndarray, " offs"]


def step_times(person: SimulatedPerson) -> tuple[StepTimes, StepTimes]:
    """True foot strikes and foot offs of the left and of the right foot."""
    if person.steps is None:
        return (StepTimes(np.zeros(0), np.zeros(0)),) * 2
    left, right = (_times_of(steps) for steps in person.steps)
    return left, right


def flights_s(person: SimulatedPerson) -> Float[np.ndarray, "jumps 2"]:
    """Times at which both feet leave the floor and touch it again, of each jump."""
    hop_m = np.zeros(len(person.present)) if person.hop_m is None else person.hop_m
    borders = np.flatnonzero(np.diff((hop_m > _LEAST_HOP_M).astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    # The rows before and after the flight are the last and the first on the floor.
    return (borders + np.array([-1, 0])) / GRID_HZ


def _times_of(steps: Steps) -> StepTimes:
    swings = steps.share > steps.stance
    off = np.flatnonzero(swings[1:] & ~swings[:-1])
    left = steps.share - steps.stance
    share = -left[off] / np.maximum(left[off + 1] - left[off], 1e-12)
    landed = np.flatnonzero(steps.share[1:] < steps.share[:-1] - 0.5)
    before = 1.0 - steps.share[landed]
    of_step = before / np.maximum(before + steps.share[landed + 1], 1e-12)
    return StepTimes((landed + of_step) / GRID_HZ, (off + share) / GRID_HZ)
