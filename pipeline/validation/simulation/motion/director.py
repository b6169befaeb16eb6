"""Random scripts for people who move in an area without collisions.

People are planned one after the other, each around the routes of the people planned before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.validation.simulation.motion.locomotion import GRID_HZ, Route, Stance, follow, lay_out
from pipeline.validation.simulation.motion.script import Away, Cue, Gesture, Role, Stay, Turn, Walk
from pipeline.validation.simulation.views.occlusion import Box

_STEP = 10
"""Distance in rows of the grid between two checks for collisions."""
_NUM_CANDIDATES = 40
# A cue must not end where another person passes within this time.
_LOOKAHEAD_S = 2.0
_BOX_CLEARANCE_M = 0.45
_SHORTEST_WALK_M = 0.6

Way = Float[np.ndarray, "times 2"]


@dataclass(frozen=True, slots=True)
class Cast:
    """People who act at random."""

    num_people: int  # Number of people
    area_m: tuple[float, float]  # Size of their area around the origin: width along X and depth along Y
    gap_m: float = 0.8  # Least distance between two people, from centre to centre
    walking: float = 0.6  # Share of walks among the cues
    # Gestures of the other cues
    gestures: tuple[Gesture, ...] = (Gesture.IDLE, Gesture.TALK, Gesture.WAVE, Gesture.POINT)
    # Places at which people enter and leave; without doors all people are present all the time
    doors_m: tuple[tuple[float, float], ...] = ()


def improvise(cast: Cast, boxes: Sequence[Box], duration_s: float, rng: np.random.Generator) -> tuple[Role, ...]:
    """Draw the script of each person. If no tried cue keeps the gap, the cue with the largest clearance is taken."""
    num_looks = -(-round(duration_s * GRID_HZ) // _STEP) + 1
    others = np.zeros((0, num_looks, 2))
    roles: list[Role] = []
    for _ in range(cast.num_people):
        role = _improvise_role(cast, boxes, duration_s, others, rng)
        route, _, _ = lay_out(role, (num_looks - 1) * _STEP / GRID_HZ)
        others = np.concatenate([others, _positions([route])[None, ::_STEP]])
        roles.append(role)
    return tuple(roles)


def _improvise_role(
    cast: Cast,
    boxes: Sequence[Box],
    duration_s: float,
    others: Float[np.ndarray, "people looks 2"],
    rng: np.random.Generator,
) -> Role:
    start = _start(cast, boxes, others, rng)
    stance, num_rows = Stance(start.start_m, start.facing_rad, 0.0), 1
    cues: list[Cue] = []
    acts_left = 0
    while num_rows < duration_s * GRID_HZ:
        tried = []
        for _ in range(_NUM_CANDIDATES):
            candidate = _candidate(cast, stance, acts_left, is_first=not cues, rng=rng)
            routes = _follow_all(candidate, stance)
            clearance = _clearance(_positions(routes), num_rows, others, boxes, cast.gap_m)
            tried.append((clearance, candidate, routes))
            if clearance >= 1:
                break
        _, chosen, routes = max(tried, key=lambda attempt: attempt[0])
        cues += chosen
        stance = routes[-1].end
        num_rows += sum(len(route.steps) for route in routes)
        returned = any(isinstance(cue, Away) for cue in chosen)
        acts_left = int(rng.integers(1, 4)) if returned else acts_left - 1
    return Role(start.start_m, start.facing_rad, tuple(cues))


def _start(
    cast: Cast, boxes: Sequence[Box], others: Float[np.ndarray, "people looks 2"], rng: np.random.Generator
) -> Role:
    """Draw a start in the area, or at a door."""
    if cast.doors_m:
        door = cast.doors_m[rng.integers(len(cast.doors_m))]
        return Role(door, _towards_center(door), ())
    places = [_place(cast, rng) for _ in range(_NUM_CANDIDATES)]
    clear = [_clearance(np.array([place]), 0, others, boxes, cast.gap_m) for place in places]
    return Role(places[int(np.argmax(np.minimum(clear, 1.0)))], float(rng.uniform(-np.pi, np.pi)), ())


def _candidate(
    cast: Cast, stance: Stance, acts_left: int, *, is_first: bool, rng: np.random.Generator
) -> tuple[Cue, ...]:
    """Draw the next cues."""
    if cast.doors_m and acts_left <= 0:
        leave, enter = (cast.doors_m[rng.integers(len(cast.doors_m))] for _ in range(2))
        duration_s = float(rng.uniform(1.0, 8.0) if is_first else rng.uniform(4.0, 8.0))
        # Includes the walk into the area, so that the door stays free.
        coming = (Away(duration_s, enter, _towards_center(enter)), Walk(_place(cast, rng)))
        return coming if is_first else (Walk(leave, float(rng.uniform(1.0, 1.5))), *coming)
    place = _place(cast, rng)
    if rng.random() < cast.walking and np.hypot(*np.subtract(place, stance.xy_m)) > _SHORTEST_WALK_M:
        return (Walk(place, float(rng.uniform(0.9, 1.5))),)
    gesture = cast.gestures[rng.integers(len(cast.gestures))]
    stay = Stay(float(rng.uniform(1.5, 4.0)), gesture)
    return (Turn(float(rng.uniform(-np.pi, np.pi))), stay) if rng.random() < 0.4 else (stay,)


def _place(cast: Cast, rng: np.random.Generator) -> tuple[float, float]:
    x, y = rng.uniform(-0.5, 0.5, 2) * cast.area_m
    return float(x), float(y)


def _towards_center(place_m: tuple[float, float]) -> float:
    return float(np.arctan2(-place_m[1], -place_m[0]))


def _follow_all(cues: Sequence[Cue], stance: Stance) -> list[Route]:
    routes: list[Route] = []
    for cue in cues:
        routes += follow(cue, routes[-1].end if routes else stance)
    return routes


def _positions(routes: Sequence[Route]) -> Way:
    """Positions on routes in metres, NaN while the person is absent."""
    return np.concatenate([np.where(route.present[:, None], route.xy_m, np.nan) for route in routes])


def _clearance(
    way: Way, first_row: int, others: Float[np.ndarray, "people looks 2"], boxes: Sequence[Box], gap_m: float
) -> float:
    """Smallest distance to other people as a share of the gap, 1 or more for a clear way; 0 in a box."""
    looks = way[-first_row % _STEP :: _STEP]
    looks = np.concatenate([looks, np.tile(way[-1], (round(_LOOKAHEAD_S * GRID_HZ / _STEP), 1))])
    for box in boxes:
        low, high = np.asarray(box.min_m[:2]) - _BOX_CLEARANCE_M, np.asarray(box.max_m[:2]) + _BOX_CLEARANCE_M
        if ((looks > low) & (looks < high)).all(-1).any():
            return 0.0
    begin = -(-first_row // _STEP)
    planned = others[:, begin : begin + len(looks)]
    distance_m = np.linalg.norm(planned - looks[: planned.shape[1]], axis=-1)
    return float(np.nanmin(distance_m, initial=np.inf)) / gap_m


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
