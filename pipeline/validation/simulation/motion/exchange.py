"""Random scripts for people who stand close together and exchange places."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.validation.simulation.motion.locomotion import GRID_HZ, Stance, follow
from pipeline.validation.simulation.motion.script import Cue, Gesture, Role, Stay, Turn, Walk

# Angle between the way and the heading at its start: two people who exchange places pass each other on their left.
_AVOIDING_RAD = 0.9
_PAUSE_S = (0.3, 1.5)
_SPEED_M_S = (0.9, 1.4)
_GESTURES = Gesture.IDLE, Gesture.TALK, Gesture.POINT
# Neighbours are not farther apart than this, in gaps.
_NEAR = 1.1


@dataclass(frozen=True, slots=True)
class PlaceExchange:
    """People who stand in a group, one in the middle and the others around, and exchange places with neighbours."""

    num_people: int  # Number of people, two to seven
    gap_m: float  # Distance of neighbours from centre to centre
    num_pairs: int = 2  # Largest number of pairs who exchange places at a time


def exchange(cast: PlaceExchange, duration_s: float, rng: np.random.Generator) -> tuple[Role, ...]:
    """Draw the script of each person: pairs of neighbours exchange places round by round, the others stay."""
    places_m = _places(cast)
    holder = rng.permutation(cast.num_people)  # person at each place
    starts = [Role(_point(places_m[place]), float(rng.uniform(-np.pi, np.pi)), ()) for place in np.argsort(holder)]
    cues: list[list[Cue]] = [[] for _ in starts]
    stances = [Stance(start.start_m, start.facing_rad, 0.0) for start in starts]
    ready_s = np.zeros(cast.num_people)
    while ready_s.max() < duration_s:
        for first, second in _pairs(places_m, cast, rng):
            for place, target in ((first, second), (second, first)):
                way_m = places_m[target] - places_m[place]
                heading_rad = float(np.arctan2(way_m[1], way_m[0])) + _AVOIDING_RAD
                walk = Walk(_point(places_m[target]), float(rng.uniform(*_SPEED_M_S)))
                person = holder[place]
                for cue in (Turn(heading_rad), walk):
                    cues[person].append(cue)
                    for route in follow(cue, stances[person]):
                        stances[person] = route.end
                        ready_s[person] += len(route.steps) / GRID_HZ
            holder[[first, second]] = holder[[second, first]]
        end_s = ready_s.max() + rng.uniform(*_PAUSE_S)
        for person in range(cast.num_people):
            pause = Stay(float(end_s - ready_s[person]), _GESTURES[rng.integers(len(_GESTURES))])
            cues[person].append(pause)
        ready_s[:] = end_s
    return tuple(
        Role(start.start_m, start.facing_rad, tuple(person)) for start, person in zip(starts, cues, strict=True)
    )


def _places(cast: PlaceExchange) -> Float[np.ndarray, "places 2"]:
    """The middle and the corners of a hexagon around it, which are neighbours of each other."""
    angle = np.arange(6) * np.pi / 3
    corners = np.column_stack([np.cos(angle), np.sin(angle)])
    return cast.gap_m * np.concatenate([np.zeros((1, 2)), corners])[: cast.num_people]


def _pairs(
    places_m: Float[np.ndarray, "places 2"], cast: PlaceExchange, rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Draw disjoint pairs of neighbouring places."""
    apart_m = np.linalg.norm(places_m[:, None] - places_m, axis=-1)
    near = [(int(first), int(second)) for first, second in np.argwhere(apart_m < _NEAR * cast.gap_m) if first < second]
    pairs: list[tuple[int, int]] = []
    for number in rng.permutation(len(near)).tolist():
        if len(pairs) < cast.num_pairs and not set(near[number]) & {place for pair in pairs for place in pair}:
            pairs.append(near[number])
    return pairs


def _point(place_m: Float[np.ndarray, " 2"]) -> tuple[float, float]:
    return float(place_m[0]), float(place_m[1])
