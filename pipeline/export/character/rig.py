"""Nodes of a character's file in their rest pose: a tree of bones with places, rotations and scales."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.session_codes import CHARACTER_UNREADABLE

MAX_NODES = 20_000
"""Largest number of nodes of a file."""
MAX_LEVELS = 512
"""Largest number of levels of nodes."""
MAX_COORDINATE = 1e9
"""Largest coordinate: larger ones are damage, and products of a few of them don't overflow."""
MAX_SCALE, MIN_SCALE = 1e6, 1e-9
"""Scales between which nodes are."""

_EXPORT_AGAIN = "Export the character once more, as GLB (binary glTF 2.0) with everything inside."


class CharacterFileError(Exception):
    """A file can't be used: code, message and hint."""

    def __init__(self, message: str, code: Code = CHARACTER_UNREADABLE, hint: str = _EXPORT_AGAIN) -> None:
        super().__init__(message)
        self.code, self.message, self.hint = code, message, hint


@contextlib.contextmanager
def checked(name: str) -> Iterator[None]:
    """Block in which errors of a file become an ``InputError`` with the file's name."""
    try:
        yield
    except CharacterFileError as error:
        raise InputError([Problem(error.code, error.message, file=name, hint=error.hint)]) from error


@dataclass(frozen=True, eq=False)
class CharacterRig:
    """Tree of nodes in the rest pose; nodes are numbered as in the file.

    A point of a node is a point of its parent after scale, rotation and translation, in this order. Positions are in
    the file's axes and unit.
    """

    names: tuple[str, ...]  # Name of each node, all different
    parents: Int[np.ndarray, " nodes"]  # Number of each node's parent, -1 at the top
    # Rest pose of each node in its parent; quaternions are (x, y, z, w)
    translations: Float[np.ndarray, "nodes 3"]
    rotations: Float[np.ndarray, "nodes 4"]
    scales: Float[np.ndarray, "nodes 3"]
    is_bone: Bool[np.ndarray, " nodes"]  # Nodes that belong to the skeleton

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Numbers of all nodes, parents before their children."""
        numbers = [number for number, parent in enumerate(self.parents.tolist()) if parent < 0]
        for number in numbers:  # It grows meanwhile.
            numbers += self.children[number]
        return tuple(numbers)

    @cached_property
    def bones(self) -> tuple[int, ...]:
        """Numbers of the nodes that belong to the skeleton, parents before their children."""
        return tuple(number for number in self.order if self.is_bone[number])

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of each node's children."""
        children: list[list[int]] = [[] for _ in self.names]
        for number, parent in enumerate(self.parents.tolist()):
            if parent >= 0:
                children[parent].append(number)
        return tuple(map(tuple, children))

    @cached_property
    def locals(self) -> Float[np.ndarray, "nodes 4 4"]:
        """Matrix from each node to its parent in the rest pose."""
        matrices = np.zeros((len(self.names), 4, 4))
        matrices[:, :3, :3] = Rotation.from_quat(self.rotations).as_matrix() * self.scales[:, None]
        matrices[:, :3, 3] = self.translations
        matrices[:, 3, 3] = 1.0
        return read_only(matrices)

    @cached_property
    def worlds(self) -> Float[np.ndarray, "nodes 4 4"]:
        """Matrix from each node to the scene in the rest pose."""
        matrices = np.array(self.locals)
        for number in self.order:
            if self.parents[number] >= 0:
                matrices[number] = matrices[self.parents[number]] @ self.locals[number]
        return read_only(matrices)

    @cached_property
    def positions(self) -> Float[np.ndarray, "nodes 3"]:
        """Position of each node in the scene in the rest pose."""
        return self.worlds[:, :3, 3]

    def path(self, above: int, below: int) -> tuple[int, ...]:
        """Nodes from one node down to another, both included; empty if the second is not below the first."""
        nodes = [below]
        while nodes[-1] != above:
            if self.parents[nodes[-1]] < 0:
                return ()
            nodes.append(int(self.parents[nodes[-1]]))
        return tuple(reversed(nodes))

    def ancestors(self, number: int) -> tuple[int, ...]:
        """A node and all nodes above it, from the node up."""
        nodes = [number]
        while self.parents[nodes[-1]] >= 0:
            nodes.append(int(self.parents[nodes[-1]]))
        return tuple(nodes)

    def common_ancestor(self, *numbers: int) -> int | None:
        """Lowest node that is above all of some nodes, or one of them; ``None`` if they have no such node."""
        above = [self.ancestors(number) for number in numbers]
        return next((node for node in above[0] if all(node in others for others in above)), None)

    def below(self, number: int) -> tuple[int, ...]:
        """A node and all nodes below it, parents first."""
        nodes = [number]
        for node in nodes:  # It grows meanwhile.
            nodes += self.children[node]
        return tuple(nodes)

    def posed(
        self,
        translations: Float[np.ndarray, "nodes 3"],
        rotations: Float[np.ndarray, "nodes 4"],
        scales: Float[np.ndarray, "nodes 3"],
    ) -> "CharacterRig":
        """CharacterRig with another rest pose."""
        return replace(self, translations=translations, rotations=rotations, scales=scales)
