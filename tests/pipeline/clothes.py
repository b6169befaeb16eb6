"""Clothes of simulated people: colours of their detections, as pictures would give them."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Float

from pipeline.detection.appearance import NUM_BINS, PARTS
from pipeline.validation.simulation.scenes import Simulation
from pipeline.validation.simulation.views.detector import UNASSIGNED

# Concentration of the colours of clothes over the bins: most are in a few of them.
_CONCENTRATION = 0.15
# Least share of a bin that a picture shows, by light and folds.
_LEAST_SHOWN = 0.3


def dress(simulation: Simulation, measure_clothes: Callable[[int, float], int]) -> Simulation:
    """Give the people clothes.

    ``measure_clothes``: number of the clothes that a person wears at a time in seconds; each number has its own
    colours. Returns the simulation with colours of its detections, see ``detection.appearance``, zeros for false
    positives.
    """
    rng, detections = np.random.default_rng(0), {}
    for name, of_camera in simulation.detections.items():
        persons, times_s = simulation.identities[name], simulation.times[name].time_s[of_camera.frame]
        worn = zip(persons.tolist(), times_s.tolist(), strict=True)
        shares = [_share(None if person == UNASSIGNED else measure_clothes(person, time_s)) for person, time_s in worn]
        shown = np.reshape(shares, (-1, len(PARTS), NUM_BINS))
        shown = shown * rng.uniform(_LEAST_SHOWN, 1.0, shown.shape)
        total = shown.sum(-1, keepdims=True)
        colour = np.rint(255 * shown / np.where(total > 0, total, 1.0)).astype(np.uint8)
        detections[name] = replace(of_camera, colour=colour)
    return replace(simulation, detections=detections)


@cache
def _share(clothes: int | None) -> Float[np.ndarray, "parts bins"]:
    """Shares of the colours of clothes; zeros without any."""
    if clothes is None:
        return np.zeros((len(PARTS), NUM_BINS))
    return np.random.default_rng(clothes).dirichlet(np.full(NUM_BINS, _CONCENTRATION), len(PARTS))
