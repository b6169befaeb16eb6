"""A character in motion in the axes of its files, Y up and facing +Z where the person faces -Y, in its own unit."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.export.character.bone_names import HIPS
from pipeline.export.character.retarget import CharacterMotion, node_place
from pipeline.export.presets import Y_UP_FROM_WORLD
from pipeline.export.timelines import held
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw, times


def chained_places(
    parents: Sequence[int],
    offsets: Float[np.ndarray, "bones 3"],
    turns: Sequence[Float[np.ndarray, "3 3"] | None],
    moving_offsets: Mapping[int, Float[np.ndarray, "frames 3"]],
    moving_turns: Mapping[int, Float[np.ndarray, "frames 3 3"]],
) -> list[Float[np.ndarray, "_ 3"]]:
    """Places of bones in the axes above the tree; a bone that nothing moves has one place for all frames.

    ``parents``: place of each bone's parent in the list, before the bone; -1 at the top. ``offsets``, ``turns``: place
    of each bone in its parent, and its rotation and scale, ``None`` for the identity. ``moving_offsets``,
    ``moving_turns``: places and rotations of bones that move, by place in the list.
    """
    places: list[Float[np.ndarray, "_ 3"]] = []
    worlds: list[Float[np.ndarray, "_ 3 3"]] = []
    for bone, parent in enumerate(parents):
        place, world = (places[parent], worlds[parent]) if parent >= 0 else (np.zeros((1, 3)), np.eye(3)[None])
        if bone in moving_offsets:
            places.append(place + (world @ moving_offsets[bone][..., None])[..., 0])
        else:
            places.append(place + times(world, offsets[bone]))
        turn = turns[bone]
        if bone in moving_turns:
            world = world @ moving_turns[bone]
        elif turn is not None:
            world = times(world, turn)
        worlds.append(world)
    return places


def together(places: Sequence[Float[np.ndarray, "_ 3"]], num_frames: int) -> Float[np.ndarray, "frames bones 3"]:
    """Places of bones in one array."""
    joined = np.empty((num_frames, len(places), 3))
    for bone, place in enumerate(places):
        joined[:, bone] = place
    return joined


@dataclass(frozen=True, slots=True, eq=False)
class PosedCharacter:
    """Content of a character's file."""

    motion: CharacterMotion
    name: str  # Name of the person
    frames: range  # Output frames of the file, the motion's frames among them
    is_present: Bool[np.ndarray, " frames"]  # Frames of the file in which the person is there
    origin_m: Float[np.ndarray, " 3"]  # World position in the person's metres that is the origin of the file

    @property
    def own_frames(self) -> range:
        """Output frames of the motion."""
        return self.motion.source.frames

    @property
    def hips(self) -> int:
        """Number of the node of the hips."""
        return self.motion.figure.joints[HIPS]

    def held(self) -> "PosedCharacter":
        """Character in all frames of the file: before and after its own frames the nearest pose holds."""
        motion, own, frames = self.motion, self.own_frames, self.frames
        source = motion.source
        still = replace(
            source,
            start_frame=frames.start,
            root_m=held(source.root_m, own, frames),
            parent_from_joint=held(source.parent_from_joint, own, frames),
        )
        posed = _in_all(motion, lambda values: held(values, own, frames))
        return replace(self, motion=replace(posed, source=still))

    def in_rows(self, rows: slice) -> "PosedCharacter":
        """Character in some rows of its motion alone."""
        return replace(self, motion=_in_all(self.motion, lambda values: values[rows]))

    def node_turn(self, node: int) -> Float[np.ndarray, "frames 3 3"]:
        """Rotation of a node from the rest pose about the skeleton's axes; nodes above the hips do not turn."""
        turns = self.motion.turns
        for above in self.motion.figure.rig.ancestors(node):
            if above in turns:
                return turns[above]
        return np.broadcast_to(np.eye(3), (len(self.motion.hips), 3, 3))

    def hips_places(self) -> Float[np.ndarray, "frames 3"]:
        """Places of the hips in the file's axes."""
        return self._in_file(self.motion.hips)

    def _in_file(self, places: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3"]:
        return (places - self.motion.scale * self.origin_m) @ Y_UP_FROM_WORLD.T

    def quaternions(self, node: int) -> Float[np.ndarray, "frames 4"]:
        """Rotations (x, y, z, w) of a node that turns, to its parent in the file."""
        return continuous_quat_xyzw(Rotation.from_matrix(self.matrices(node), assume_valid=True))

    def matrices(self, node: int) -> Float[np.ndarray, "frames 3 3"]:
        """Rotations of a node that turns, to its parent in the file."""
        rig, figure = self.motion.figure.file.rig, self.motion.figure
        at_rest = figure.skeleton_from_file @ unscaled_rotation(rig.worlds[node])
        parent = int(rig.parents[node])
        if not self._moves(parent):
            above = np.eye(3) if parent < 0 else unscaled_rotation(rig.worlds[parent])
            return times((above.T @ Y_UP_FROM_WORLD) @ self.node_turn(node), at_rest)
        above = figure.skeleton_from_file @ unscaled_rotation(rig.worlds[parent])
        return times(times(self.node_turn(parent), above).swapaxes(1, 2) @ self.node_turn(node), at_rest)

    def translations(self, node: int) -> Float[np.ndarray, "frames 3"]:
        """Translations of a node of ``shifting`` in its parent in the file."""
        motion, figure, rig = self.motion, self.motion.figure, self.motion.figure.file.rig
        place, parent = node_place(figure, motion.hips, motion.turns, node), int(rig.parents[node])
        if self._moves(parent):
            way = place - node_place(figure, motion.hips, motion.turns, parent)
            axes = times(self.node_turn(parent), figure.skeleton_from_file @ rig.worlds[parent, :3, :3])
            return np.asarray(np.linalg.solve(axes, way[..., None])[..., 0])
        above = np.eye(4) if parent < 0 else rig.worlds[parent]
        return (self._in_file(place) - above[:3, 3]) @ np.linalg.inv(above[:3, :3]).T

    def _moves(self, node: int) -> bool:
        """True if a node of the file, -1 for none, is one of ``shifting`` or below it."""
        return node >= 0 and not set(self.shifting()).isdisjoint(self.motion.figure.file.rig.ancestors(node))

    def shifting(self) -> tuple[int, ...]:
        """Nodes whose place in their parent changes: the hips, and ends of limbs that hang elsewhere in the file."""
        figure = self.motion.figure
        return (self.hips, *np.flatnonzero(figure.rig.parents != figure.file.rig.parents).tolist())

    def turning(self) -> tuple[int, ...]:
        """Nodes that turn, parents before their children."""
        return tuple(node for node in self.motion.figure.rig.order if node in self.motion.turns)

    def bones(self) -> tuple[int, ...]:
        """Bones from the hips down, each after its parent, and the nodes between them; the hips first."""
        rig = self.motion.figure.rig
        below = rig.below(self.hips)
        needed = {above for node in below if rig.is_bone[node] for above in rig.ancestors(node)}
        return tuple(node for node in below if node in needed)


def unscaled_rotation(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    """Rotation of a matrix whose scales are even."""
    turned = matrix[:3, :3]
    return np.asarray(turned / np.linalg.norm(turned, axis=0))


def present_ranges(is_present: Bool[np.ndarray, " frames"], frames: range) -> list[list[int]]:
    """Ranges of output frames in which a person is there, first frame and the one after the last."""
    borders = np.flatnonzero(np.diff(is_present.astype(np.int8), prepend=0, append=0)) + frames.start
    return [[int(start), int(stop)] for start, stop in borders.reshape(-1, 2)]


def bone_places(posed: PosedCharacter, nodes: tuple[int, ...], frames: range) -> Float[np.ndarray, "frames bones 3"]:
    """Places of bones in the person's world (metres of the person) in some frames of a file."""
    motion = posed.motion
    figure, rig, own = motion.figure, motion.figure.rig, posed.own_frames
    turns: dict[int, Float[np.ndarray, "frames 3 3"]] = {}
    places: dict[int, Float[np.ndarray, "frames 3"]] = {}
    for node in rig.below(posed.hips):
        parent = int(rig.parents[node])
        if node == posed.hips:
            places[node] = held(motion.hips, own, frames)
        else:
            places[node] = places[parent] + times(turns[parent], figure.positions[node] - figure.positions[parent])
        turns[node] = held(motion.turns[node], own, frames) if node in motion.turns else turns[parent]
    return together([places[node] for node in nodes], len(frames)) / motion.scale


def names_by_node(names: Mapping[int, str]) -> dict[int, str]:
    """Names without white space, all different."""
    bare = {node: "_".join(name.split()) or "bone" for node, name in names.items()}
    taken: dict[str, int] = {}
    for name in bare.values():
        taken[name] = taken.get(name, 0) + 1
    return {node: f"{name}_{node}" if taken[name] > 1 else name for node, name in bare.items()}


def _in_all(motion: CharacterMotion, choose: Callable[[np.ndarray], np.ndarray]) -> CharacterMotion:
    """Motion with the rows that ``choose`` returns of each of its arrays; its source stays."""
    return replace(
        motion,
        hips=choose(motion.hips),
        turns={node: choose(turns) for node, turns in motion.turns.items()},
        stands={side: choose(stands) for side, stands in motion.stands.items()},
        ground=choose(motion.ground),
    )
