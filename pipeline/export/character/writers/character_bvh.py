"""BVH of a character's bones in motion, from the hips down.

The rest pose is the character's own, with Y up; a unit is a hundredth of the character's: centimetres, where it is in
metres. Rotations are Z X Y. Names have no white space. Before and after the person's own frames the nearest pose holds.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.export.character.writers.posed import PosedCharacter, chained_places, names_by_node, together
from pipeline.export.presets import Y_UP_FROM_WORLD
from pipeline.export.timelines import filled, fixed, held_blocks, read_rows
from pipeline.export.writers.bvh import BvhNode, encode_head, read_head
from pipeline.export.writers.euler import euler_deg, turned

_UNITS = 100.0
_DECIMALS, _ANGLE_DECIMALS = 3, 4
_ORDER = "ZXY"
# Length of the end of a bone without children, as a share of the bone before it.
_END = 0.5


def encode(posed: PosedCharacter) -> Iterator[bytes]:
    """Write a character's bones in motion as BVH, piece by piece. Equal motions give equal bytes."""
    rig, motion = posed.motion.figure.rig, posed.motion
    bones = depth_first(posed)
    yield encode_head(_nodes(posed, bones), len(posed.frames), motion.source.frame_rate_hz)
    turning = [node for node in bones if node in motion.turns]
    places = (posed.hips_places() * _UNITS).astype(float)
    # Most bones of a face never turn: their angles are text that stays.
    (still,) = fixed(np.zeros((1, 3)), _ANGLE_DECIMALS)
    turns_as = " ".join([f"%.{_ANGLE_DECIMALS}f"] * 3)
    template = " ".join(turns_as if node in motion.turns else still for node in bones)
    before_deg = np.zeros((1, len(turning), 3))
    for block, num_times in held_blocks(posed.own_frames, posed.frames):
        rows = slice(block.start - posed.own_frames.start, block.stop - posed.own_frames.start)
        turns = np.empty((len(block), len(turning), 3, 3))
        for place, node in enumerate(turning):
            above = np.eye(3) if node == posed.hips else posed.node_turn(int(rig.parents[node]))[rows].swapaxes(1, 2)
            turns[:, place] = Y_UP_FROM_WORLD @ (above @ motion.turns[node][rows]) @ Y_UP_FROM_WORLD.T
        before_deg = euler_deg(turns, [_ORDER] * len(turning), before_deg[-1])
        lines = zip(
            fixed(places[rows], _DECIMALS),
            filled(template, before_deg.reshape(len(block), -1), _ANGLE_DECIMALS),
            strict=True,
        )
        yield "".join(f"{place} {turn}\n" for place, turn in lines).encode("ascii") * num_times


def depth_first(posed: PosedCharacter) -> tuple[int, ...]:
    """Bones, children right after their parents, as the file lists them."""
    rig, bones = posed.motion.figure.rig, set(posed.bones())
    ordered, waiting = [], [posed.hips]
    while waiting:
        ordered.append(waiting.pop())
        waiting += [child for child in reversed(rig.children[ordered[-1]]) if child in bones]
    return tuple(ordered)


def _nodes(posed: PosedCharacter, bones: tuple[int, ...]) -> list[BvhNode]:
    """Bones, and the ends of those without children."""
    figure, rig = posed.motion.figure, posed.motion.figure.rig
    places = figure.positions @ Y_UP_FROM_WORLD.T * _UNITS
    names = names_by_node({node: rig.names[node] for node in bones})
    has_children = {int(rig.parents[node]) for node in bones if node != posed.hips}
    nodes = []
    for node in bones:
        offset = np.zeros(3) if node == posed.hips else places[node] - places[figure.rig.parents[node]]
        depth, (own, end) = len(rig.path(posed.hips, node)) - 1, fixed(np.stack([offset, offset * _END]), _DECIMALS)
        nodes.append(BvhNode(depth, names[node], own, _ORDER))
        if node not in has_children:
            nodes.append(BvhNode(depth + 1, "", end, ""))
    return nodes


def read_xyz(
    path: Path, units_per_m: float, origin_m: Float[np.ndarray, " 3"]
) -> Iterator[Float[np.ndarray, "_ bones 3"]]:
    """Read the places of all bones from a file of ``encode``, block by block, in the person's world and metres.

    ``units_per_m`` is the scale of the person's path, ``origin_m`` the world position of the file's origin.
    """
    with path.open(encoding="utf-8") as file:
        nodes = read_head(file)
        bones = [place for place, node in enumerate(nodes) if node.name]
        offsets = np.array([nodes[place].offset for place in bones])
        parents = [bones.index(above) if (above := nodes[place].parent) >= 0 else -1 for place in bones]
        for values in read_rows(file, " "):
            places = _places(values, offsets, parents)
            yield places / _UNITS @ Y_UP_FROM_WORLD / units_per_m + origin_m


def _places(
    values: Float[np.ndarray, "frames channels"], offsets: Float[np.ndarray, "bones 3"], parents: list[int]
) -> Float[np.ndarray, "frames bones 3"]:
    angles_deg = values[:, 3:].reshape(len(values), -1, 3)
    (turning,) = np.nonzero(angles_deg.any((0, 2)))
    turns = turned(angles_deg[:, turning], _ORDER)
    moving = {bone: turns[:, place] for place, bone in enumerate(turning.tolist())}
    places = chained_places(parents, offsets, [None] * len(parents), {0: values[:, :3]}, moving)
    return together(places, len(values))
