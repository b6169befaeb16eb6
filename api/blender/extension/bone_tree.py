"""Bones of an armature: their tree, and which joint of a person each of them follows.

Limbs, fingers and the head are recognised by their names as the service does it
(``pipeline.export.character.bone_names``); the bones of the trunk follow from the tree.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from pipeline.export.character.bone_names import HEAD, HIPS, LIMBS, REQUIRED, SIDES, joints_by_name


@dataclass(frozen=True)
class BoneTree:
    """Tree of bones, numbered."""

    names: tuple[str, ...]
    parents: tuple[int, ...]  # Number of each bone's parent, -1 at the top

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of each bone's children."""
        children: list[list[int]] = [[] for _ in self.names]
        for number, parent in enumerate(self.parents):
            if parent >= 0:
                children[parent].append(number)
        return tuple(map(tuple, children))

    @cached_property
    def bones(self) -> tuple[int, ...]:
        """Numbers of all bones, parents before their children."""
        numbers = [number for number, parent in enumerate(self.parents) if parent < 0]
        for number in numbers:  # It grows meanwhile.
            numbers += self.children[number]
        return tuple(numbers)

    def below(self, number: int, /) -> tuple[int, ...]:
        """A bone and all bones below it, parents first."""
        numbers = [number]
        for bone in numbers:  # It grows meanwhile.
            numbers += self.children[bone]
        return tuple(numbers)

    def above(self, number: int) -> tuple[int, ...]:
        """A bone and all bones above it, from the bone up."""
        numbers = [number]
        while self.parents[numbers[-1]] >= 0:
            numbers.append(self.parents[numbers[-1]])
        return tuple(numbers)

    def common(self, numbers: Sequence[int]) -> int | None:
        """Lowest bone that is above all of some bones, or one of them; ``None`` without one."""
        ways = [self.above(number) for number in numbers]
        return next((bone for bone in ways[0] if all(bone in way for way in ways)), None)

    def path(self, top: int, bottom: int) -> tuple[int, ...]:
        """Bones from one bone down to another, both included; empty if the second is not below the first."""
        way = self.above(bottom)
        return tuple(reversed(way[: way.index(top) + 1])) if top in way else ()


@dataclass(frozen=True, slots=True)
class BoneMap:
    """Bones of an armature by joint."""

    bones: Mapping[str, str]  # Bone of each joint, ``Hips`` among them
    # Bones between hips and arms, and between arms and head, from below
    spine: tuple[str, ...]
    neck: tuple[str, ...]


def recognise_bones(tree: BoneTree) -> dict[str, str]:
    """Bones by joint that their names tell, ``Hips`` among them."""
    bones = {joint: tree.names[number] for joint, number in joints_by_name(tree, {}).items()}
    legs = [tree.names.index(bones[joint]) for joint in ("LeftUpLeg", "RightUpLeg") if joint in bones]
    arms = [tree.names.index(bones[joint]) for joint in ("LeftArm", "RightArm", HEAD) if joint in bones]
    hips = tree.common([*legs, *arms]) if len(legs) == len(SIDES) and arms else None
    return bones if hips is None else {HIPS: tree.names[hips], **bones}


def bone_problems(tree: BoneTree, bones: Mapping[str, str]) -> list[str]:
    """Sentences about what is wrong with bones by joint; empty if motion can be put on them."""
    if any(name.startswith("MCH-") for name in tree.names):
        return [
            "Rigify made this armature: its bones follow controls by constraints. Choose its metarig, or a copy of its "
            "deforming bones without constraints."
        ]
    unknown = [bone for bone in bones.values() if bone not in tree.names]
    missing = [joint for joint in (HIPS, *REQUIRED) if joint not in bones]
    problems = []
    if unknown:
        problems.append(f"The armature has no bone {', '.join(unknown[:5])}.")
    if missing:
        problems.append(f"No bone is known for {', '.join(missing)}. Choose them in the list of bones.")
    if not problems:
        twice = sorted({bone for bone in bones.values() if list(bones.values()).count(bone) > 1})
        if twice:
            problems.append(f"These bones are chosen twice: {', '.join(twice[:5])}.")
        problems += [
            f"The bone {bones[below]} is not below {bones[above]}: set it as the bone's parent, or choose other bones."
            for limb in LIMBS
            for above, below in itertools.pairwise(limb)
            if not tree.path(tree.names.index(bones[above]), tree.names.index(bones[below]))
        ]
    return problems


def add_trunk(tree: BoneTree, bones: Mapping[str, str]) -> BoneMap:
    """Bones by joint, bones of the trunk between them included; ``bones`` has no problem."""
    numbers = {joint: tree.names.index(bone) for joint, bone in bones.items()}
    arms = [numbers[f"{side}Arm"] for side in SIDES]
    chest = tree.common([*arms, numbers[HEAD]])
    spine_numbers = () if chest is None else tree.path(numbers[HIPS], chest)[1:]
    neck_numbers = () if chest is None else tree.path(chest, numbers[HEAD])[1:-1]
    return BoneMap(
        bones,
        tuple(tree.names[number] for number in spine_numbers),
        tuple(tree.names[number] for number in neck_numbers),
    )
