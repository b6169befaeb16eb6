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
    offsets = _offsets(posed, bones)
    names = names_by_node({node: rig.names[node] for node in bones})
    yield "".join(f"{line}\n" for line in _head(posed, bones, names, offsets)).encode()
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
            above = np.eye(3) if node == posed.hips else posed.turn_of(int(rig.parents[node]))[rows].swapaxes(1, 2)
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


def _offsets(posed: PosedCharacter, bones: tuple[int, ...]) -> dict[int, Float[np.ndarray, " 3"]]:
    figure = posed.motion.figure
    places = figure.positions @ Y_UP_FROM_WORLD.T * _UNITS
    return {
        node: np.zeros(3) if node == posed.hips else places[node] - places[figure.rig.parents[node]] for node in bones
    }


def _head(
    posed: PosedCharacter,
    bones: tuple[int, ...],
    names: dict[int, str],
    offsets: dict[int, Float[np.ndarray, " 3"]],
) -> Iterator[str]:
    rig = posed.motion.figure.rig
    depth_of = {node: len(rig.path(posed.hips, node)) - 1 for node in bones}
    has_children = {int(rig.parents[node]) for node in bones if node != posed.hips}
    yield "HIERARCHY"
    for number, node in enumerate(bones):
        indent = "\t" * (depth := depth_of[node])
        yield f"{indent}{'JOINT' if depth else 'ROOT'} {names[node]}"
        yield f"{indent}{{"
        (offset,) = fixed(offsets[node][None], _DECIMALS)
        yield f"{indent}\tOFFSET {offset}"
        place = "" if depth else "Xposition Yposition Zposition "
        rotations = " ".join(f"{axis}rotation" for axis in _ORDER)
        yield f"{indent}\tCHANNELS {3 if depth else 6} {place}{rotations}"
        if node not in has_children:
            (end,) = fixed(offsets[node][None] * _END, _DECIMALS)
            yield from (f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET {end}", f"{indent}\t}}")
        after = depth_of[bones[number + 1]] if number + 1 < len(bones) else 0
        for closed in range(depth, after - 1, -1):
            yield "\t" * closed + "}"
    yield "MOTION"
    yield f"Frames: {len(posed.frames)}"
    yield f"Frame Time: {np.format_float_positional(1.0 / posed.motion.source.frame_rate_hz)}"


def read_xyz(
    path: Path, units_per_m: float, origin_m: Float[np.ndarray, " 3"]
) -> Iterator[Float[np.ndarray, "_ bones 3"]]:
    """Read the places of all bones from a file of ``encode``, block by block, in the person's world and metres.

    ``units_per_m`` is the scale of the person's path, ``origin_m`` the world position of the file's origin.
    """
    offsets: list[list[float]] = []
    parents: list[int] = []
    above: list[int] = []
    is_end = False
    with path.open(encoding="utf-8") as file:
        for line in file:
            match line.split():
                case [("ROOT" | "JOINT"), *_]:
                    parents.append(above[-1] if above else -1)
                    above.append(len(parents) - 1)
                case ["End", "Site"]:
                    is_end = True
                case ["OFFSET", *offset] if not is_end:
                    offsets.append([float(number) for number in offset])
                case ["}"]:
                    if not is_end:
                        above.pop()
                    is_end = False
                case ["Frame", "Time:", _]:
                    break
        for values in read_rows(file, " "):
            places = _places(values, np.array(offsets), parents)
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
