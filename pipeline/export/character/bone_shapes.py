"""Bones of characters by the shape of the tree in its rest pose, for names that tell nothing.

A body has two pairs of branches of equal length, each at one bone: legs, which lead away from the other pair, and arms.
Between the arms goes on what leads to the head. Sides follow from the direction in which the feet point.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import FINGERS
from pipeline.export.character.bone_names import HEAD, SIDES
from pipeline.export.character.rig import CharacterRig

# Branches of a pair: difference of their lengths, as a share; share of the longest pair that others must have.
_ALIKE, _LONG = 0.03, 0.3
# Cosine of the angle between a shin and the vertical; a bone of the foot is flatter.
_UPRIGHT = 0.75
# Most bones in a limb, and pairs of branches, that are looked at.
_MAX_CHAIN, _MAX_PAIRS = 40, 40
_MIN_FINGER_BONES, _NUM_FINGER_BONES, _LEAST_FINGERS = 2, 3, 3


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two branches of equal length at a bone."""

    at: int
    branches: tuple[int, int]
    length: float


def joints_by_shape(rig: CharacterRig) -> dict[str, int]:
    """Bones of limbs, fingers and the head by the shape of the tree: nodes by joint; empty if it is no body."""
    longest = _longest_ways(rig)
    pairs = sorted(_pairs(rig, longest), key=lambda pair: -pair.length)
    if not pairs:
        return {}
    long = [pair for pair in pairs if pair.length > _LONG * pairs[0].length][:_MAX_PAIRS]
    for first, second in itertools.combinations(long, 2):
        for legs, arms in ((first, second), (second, first)):
            found = _body(rig, longest, legs, arms)
            if found:
                return found
    return {}


def _longest_ways(rig: CharacterRig) -> dict[int, tuple[float, tuple[int, ...]]]:
    """Longest way down from each bone: its length, and the bones on it, the bone itself first."""
    ways: dict[int, tuple[float, tuple[int, ...]]] = {}
    for number in reversed(rig.order):
        options: list[tuple[float, tuple[int, ...]]] = [(0.0, (number,))]
        for child in rig.children[number]:
            if child in ways:
                length, way = ways[child]
                options.append((length + _distance(rig, number, child), (number, *way[:_MAX_CHAIN])))
        if rig.is_bone[number] or len(options) > 1:
            ways[number] = max(options, key=lambda option: option[0])
    return ways


def _pairs(rig: CharacterRig, longest: dict[int, tuple[float, tuple[int, ...]]]) -> Iterator[_Pair]:
    """Pairs of branches of equal length that part at their bone."""
    for number in rig.order:
        branches = [child for child in rig.children[number] if len(longest.get(child, (0.0, ()))[1]) >= len(SIDES)]
        # A bone with hundreds of branches is no hip: hair and cloth.
        for first, second in itertools.combinations(branches[:_MAX_CHAIN], 2):
            lengths = [longest[branch][0] for branch in (first, second)]
            ends = [rig.positions[longest[branch][1][-1]] for branch in (first, second)]
            apart = np.linalg.norm(ends[0] - ends[1])
            if max(lengths) > 0.0 and abs(lengths[0] - lengths[1]) < _ALIKE * max(lengths) and apart > 0.0:
                yield _Pair(number, (first, second), min(lengths))


def _body(
    rig: CharacterRig, longest: dict[int, tuple[float, tuple[int, ...]]], legs: _Pair, arms: _Pair
) -> dict[str, int] | None:
    """Joints of a body with some legs and arms; ``None`` if they are none."""
    hips = rig.common_ancestor(legs.at, arms.at)
    if hips is None or legs.at == arms.at or arms.at in rig.ancestors(legs.at):
        return None
    leg_ends = np.array([rig.positions[longest[branch][1][-1]] for branch in legs.branches])
    up = _unit(rig.positions[arms.at] - leg_ends.mean(0))
    trunk = rig.positions[arms.at] - rig.positions[legs.at]
    if trunk @ up <= 0.0 or (rig.positions[legs.at] - leg_ends.mean(0)) @ up <= 0.0:
        return None
    limbs = [_leg(rig, longest[branch][1], up) for branch in legs.branches]
    reaches = [_arm(rig, (arms.at, *longest[branch][1])) for branch in arms.branches]
    head = _head(rig, longest, arms, up)
    if head is None or not all(limbs) or not all(reaches):
        return None
    forward = _forward(rig, limbs, up)
    left = np.cross(up, forward)
    found = {HEAD: head}
    for parts in (limbs, reaches):
        places = [rig.positions[next(iter(limb.values()))] @ left for limb in parts if limb]
        order = (0, 1) if places[0] > places[1] else (1, 0)
        for side, number in zip(SIDES, order, strict=True):
            found |= {f"{side}{joint}": node for joint, node in (parts[number] or {}).items()}
    for side in SIDES:
        found |= _fingers(rig, longest, side, found[f"{side}Hand"])
    return found


def _leg(rig: CharacterRig, way: Sequence[int], up: Float[np.ndarray, " 3"]) -> dict[str, int] | None:
    """Hip, knee, ankle and toes among the bones of a leg; ``None`` if there are too few."""
    steps = [_unit(rig.positions[after] - rig.positions[before]) @ -up for before, after in itertools.pairwise(way)]
    hip = next((place for place, step in enumerate(steps) if step > _UPRIGHT), None)
    if hip is None:
        return None
    ankle = next((place for place in range(hip + 1, len(steps)) if steps[place] < _UPRIGHT), len(way) - 1)
    knee = _halfway(rig, way, hip, ankle)
    if knee is None:
        return None
    found = {"UpLeg": way[hip], "Leg": way[knee], "Foot": way[ankle]}
    # A last bone that nothing follows may be the tip of the foot.
    return found | ({"ToeBase": way[ankle + 1]} if ankle + 1 < len(way) else {})


def _arm(rig: CharacterRig, way: Sequence[int]) -> dict[str, int] | None:
    """Collar bone, shoulder, elbow and wrist among the bones of an arm, whose first one belongs to the trunk."""
    bones = way[1:]
    lengths = np.cumsum([0.0, *(_distance(rig, a, b) for a, b in itertools.pairwise(bones))])
    palms = (place for place, bone in enumerate(bones) if _num_fingers(rig, bone) >= _LEAST_FINGERS)
    # Simple hands have a thumb and one more finger.
    mittens = (
        place for place, bone in enumerate(bones) if _num_fingers(rig, bone) > 1 and 2 * lengths[place] > lengths[-1]
    )
    hand = next(itertools.chain(palms, mittens, [len(bones) - 1]))
    best: tuple[float, int, int] | None = None
    for shoulder, elbow in itertools.combinations(range(hand), 2):
        upper, lower = lengths[elbow] - lengths[shoulder], lengths[hand] - lengths[elbow]
        if min(upper, lower) > 0.0:
            # Both halves of an arm have about the same length, and make up most of it.
            cost = abs(np.log(upper / lower)) + 1.0 - (upper + lower) / lengths[hand]
            best = min(best or (np.inf, 0, 0), (float(cost), shoulder, elbow))
    if best is None:
        return None
    _, shoulder, elbow = best
    found = {"Arm": bones[shoulder], "ForeArm": bones[elbow], "Hand": bones[hand]}
    return found | ({"Shoulder": bones[0]} if shoulder else {})


def _num_fingers(rig: CharacterRig, bone: int) -> int:
    """Number of branches of at least two bones."""
    return sum(bool(rig.children[child]) for child in rig.children[bone])


def _head(
    rig: CharacterRig, longest: dict[int, tuple[float, tuple[int, ...]]], arms: _Pair, up: Float[np.ndarray, " 3"]
) -> int | None:
    """Head at the end of the branch between the arms that leads up farthest; ``None`` without one."""
    branches = [child for child in rig.children[arms.at] if child not in arms.branches and child in longest]
    if not branches:
        return None
    base = max(branches, key=lambda branch: (rig.positions[longest[branch][1][-1]] - rig.positions[arms.at]) @ up)
    node, way = base, [base]
    # A head is where the neck ends or parts into a face.
    while len(rig.children[node]) == 1:
        node = rig.children[node][0]
        way.append(node)
    is_end = not rig.children[node] and len(way) > 1
    return way[-2] if is_end and len(way) > len(SIDES) else way[-1]


def _halfway(rig: CharacterRig, way: Sequence[int], start: int, stop: int) -> int | None:
    """Place on a way that is nearest to the middle between two others; ``None`` if no bone lies between."""
    if stop - start < len(SIDES):
        return None
    lengths = np.cumsum([_distance(rig, a, b) for a, b in zip(way[start:stop], way[start + 1 : stop + 1], strict=True)])
    return start + 1 + int(np.abs(lengths[:-1] - lengths[-1] / 2).argmin())


def _forward(
    rig: CharacterRig, legs: Sequence[dict[str, int] | None], up: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 3"]:
    """Direction in which the feet point; glTF's, or -Y where Z is up, if they have no toes."""
    total = np.zeros(3)
    for leg in legs:
        if leg and "ToeBase" in leg:
            toes = rig.positions[leg["ToeBase"]] - rig.positions[leg["Foot"]]
            total += toes - (toes @ up) * up
    if np.linalg.norm(total) > 0.0:
        return _unit(total)
    usual = np.array([0.0, 0.0, 1.0]) if abs(up[1]) > abs(up[2]) else np.array([0.0, -1.0, 0.0])
    return _unit(usual - (usual @ up) * up)


def _fingers(
    rig: CharacterRig,
    longest: dict[int, tuple[float, tuple[int, ...]]],
    side: str,
    hand: int,
) -> dict[str, int]:
    """Fingers of a hand with all five; the thumb begins nearest to the wrist, the others are in order beside it."""
    chains = [longest[child][1] for child in rig.children[hand] if child in longest]
    chains = [chain for chain in chains if len(chain) >= _MIN_FINGER_BONES]
    if len(chains) != len(FINGERS):
        return {}
    wrist = rig.positions[hand]
    counts = sorted(map(len, chains))
    if counts[0] < counts[1] == counts[-1]:
        # The other fingers have a bone in the palm too.
        chains = [chain if len(chain) == counts[0] else chain[counts[1] - counts[0] :] for chain in chains]
        thumb = next(chain for chain in chains if chain[0] in rig.children[hand])
    else:
        thumb = min(chains, key=lambda chain: float(np.linalg.norm(rig.positions[chain[0]] - wrist)))
    others = [chain for chain in chains if chain is not thumb]
    bases = np.array([rig.positions[chain[0]] for chain in others])
    across = bases - bases.mean(0)
    axis = np.linalg.svd(across)[2][0]
    # The index finger is on the side of the thumb.
    toward = rig.positions[thumb[min(1, len(thumb) - 1)]] - bases.mean(0)
    axis = axis if axis @ toward > 0.0 else -axis
    ordered = [thumb, *(others[number] for number in np.argsort(-(across @ axis)))]
    return {
        f"{side}Hand{finger.capitalize()}{number}": node
        for finger, chain in zip(FINGERS, ordered, strict=True)
        for number, node in enumerate(chain[:_NUM_FINGER_BONES], 1)
    }


def _distance(rig: CharacterRig, first: int, second: int) -> float:
    return float(np.linalg.norm(rig.positions[first] - rig.positions[second]))


def _unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 0.0 else vector
