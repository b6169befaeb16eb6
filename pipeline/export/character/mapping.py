"""Bones of a character by the joints of the skeleton, recognised or stated by a table.

The joints are the joints of ``pipeline.motion.skeleton.model``, with toes (``LeftToeBase``), and without the trunk's
joints: all bones between hips and arms are the spine, those between arms and head the neck.

Names count before the shape of the tree: the shape may complete the named bones, but never contradicts them. In rigs
made for inverse kinematics hands and feet hang on the root; ``connected`` hangs them on their limbs.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.core.errors import InputError, Problem, listed_names, printable
from pipeline.core.findings import Finding, documents
from pipeline.core.parsing import UnreadableError, read_json
from pipeline.core.problems.finding_codes import BONE_HANGS_ELSEWHERE
from pipeline.core.problems.session_codes import BONES_INVALID, CHARACTER_BONES
from pipeline.export.character import bone_names
from pipeline.export.character.bone_shapes import joints_by_shape
from pipeline.export.character.gltf_reader import CharacterFile, decomposed
from pipeline.export.character.rig import CharacterRig

Recognition = Literal["vrm", "names", "shape", "table"]
"""Ways in which a bone is recognised: by a VRM's table, by names, by the shape of the tree, by a user's table."""

_MAX_TABLE_BYTES = 1 << 20
_CHAIN_HINT = "Give the bone this parent in the program that made the character, or correct the table of bones."
# Most of the length of the first bone of a limb that the second one has.
_MAX_LOWER_SHARE = 2.0
_HINT = 'Write a JSON object such as {"bones": {"LeftArm": "upperarm_l", "LeftShoulder": null}}.'


@dataclass(frozen=True, slots=True)
class BoneMapping:
    """Bones of a character by joint, each by its name."""

    # By a VRM's table, by names, or by the shape of the tree; ``table``: by a user's table too
    method: Literal["vrm", "names", "shape", "table"]
    bones: Mapping[str, str]  # Bone of each joint, ``Hips`` among them
    recognised_by: Mapping[str, Recognition]  # Way in which the bone of each joint was recognised
    # Bones between hips and arms, and between arms and head, from below
    spine: tuple[str, ...]
    neck: tuple[str, ...]
    twists: Mapping[str, str]  # Bones that share the twist of a limb, with the joint at the end of the limb
    missing: tuple[str, ...]  # Joints without a bone
    at_rest: tuple[str, ...]  # Bones that stay at rest
    warnings: tuple[Finding, ...]  # About hands and feet that hang elsewhere than on their limbs

    def document(self) -> dict[str, Any]:
        """Mapping as JSON; ``bones`` is a table that ``read_bone_table`` reads, null for joints without a bone."""
        return {
            "method": self.method,
            "bones": {**self.bones, **dict.fromkeys(self.missing)},
            "recognised_by": dict(self.recognised_by),
            "spine": list(self.spine),
            "neck": list(self.neck),
            "twists": dict(self.twists),
            "missing": list(self.missing),
            "at_rest": list(self.at_rest),
            "warnings": documents(self.warnings),
        }


def read_bone_table(path: Path) -> dict[str, str | None]:
    """Read a table of bones by joint, ``None`` for joints without one, from JSON.

    Raises ``InputError`` with all problems of the table.
    """
    try:
        if path.stat().st_size > _MAX_TABLE_BYTES:
            raise InputError([Problem(BONES_INVALID, "The table is too large.", file=path.name, hint=_HINT)])
        return bone_table(read_json(path.read_bytes()), path.name)
    except (OSError, UnreadableError) as error:
        raise InputError([Problem(BONES_INVALID, "The table can't be read.", file=path.name, hint=_HINT)]) from error


def bone_table(document: Any, name: str | None = None) -> dict[str, str | None]:
    """Check a table of bones, parsed from JSON; ``name`` is its file's name. Raises ``InputError``."""
    bones = document.get("bones") if isinstance(document, dict) else None
    if not isinstance(bones, dict):
        raise InputError([Problem(BONES_INVALID, "The table has no object `bones`.", file=name, hint=_HINT)])
    problems = []
    for joint, bone in bones.items():
        if joint not in (bone_names.HIPS, *bone_names.REQUIRED, *bone_names.OPTIONAL):
            hint = f"Joints are {bone_names.HIPS}, {', '.join(bone_names.REQUIRED)}, {', '.join(bone_names.OPTIONAL)}."
            problems.append(Problem(BONES_INVALID, f"There is no joint {printable(joint)}.", file=name, hint=hint))
        elif not (bone is None or isinstance(bone, str)):
            problems.append(Problem(BONES_INVALID, f"The bone of {joint} is not a name.", file=name, hint=_HINT))
    if problems:
        raise InputError(problems)
    return bones


def map_bones(character: CharacterFile, table: Mapping[str, str | None] | None = None) -> BoneMapping:
    """Recognise the bones of a character.

    ``table``: bones by joint that go before those that are recognised; ``None``: the joint has no bone. Raises
    ``InputError`` if bones are missing, or are not in the order of a body, or the table names unknown bones: all
    problems.
    """
    rig, stated = character.rig, dict(table or {})
    problems = _unknown(rig, stated, character.name)
    if problems:
        raise InputError(problems)
    nodes = {joint: rig.names.index(bone) for joint, bone in stated.items() if bone is not None}
    named, shaped = (
        {joint: node for joint, node in joints.items() if joint not in stated} | nodes
        for joints in (bone_names.joints_by_name(rig, character.humanoid), joints_by_shape(rig))
    )
    problems = _wrong(rig, named, character.name)
    if not problems:
        return _completed("vrm" if character.humanoid else "names", rig, named, stated)
    agrees = all(shaped.get(joint) == node for joint, node in named.items() if joint in bone_names.REQUIRED)
    if agrees and not _wrong(rig, shaped, character.name):
        return _completed("shape", rig, shaped, stated)
    raise InputError(problems)


def connected(rig: CharacterRig, joints: Mapping[str, int]) -> tuple[CharacterRig, tuple[str, ...]]:
    """Hang hands and feet below their limbs.

    ``joints``: nodes by joint. Returns the rig in the same rest pose, and the joints whose bones were moved below the
    bone before them. A bone of another limb, or one that is as far from its limb as no hand or foot, stays where it is.
    """
    parents = rig.parents.copy()
    translations, rotations, scales = rig.translations.copy(), rig.rotations.copy(), rig.scales.copy()
    moved = []
    for first, above, end in bone_names.LIMBS:
        if not {first, above, end} <= joints.keys() or rig.path(joints[above], joints[end]):
            continue
        node, others = joints[end], {joints[joint] for joint in bone_names.REQUIRED if joint in joints and joint != end}
        start, middle, last = rig.positions[[joints[first], joints[above], node]]
        is_near = np.linalg.norm(last - middle) < _MAX_LOWER_SHARE * np.linalg.norm(middle - start)
        in_limb = decomposed(np.linalg.inv(rig.worlds[joints[above]]) @ rig.worlds[node])
        if in_limb is not None and is_near and others.isdisjoint({*rig.ancestors(node), *rig.below(node)}):
            parents[node] = joints[above]
            translations[node], rotations[node], scales[node] = in_limb
            moved.append(end)
    return replace(rig, parents=parents, translations=translations, rotations=rotations, scales=scales), tuple(moved)


def _unknown(rig: CharacterRig, stated: Mapping[str, str | None], name: str) -> list[Problem]:
    known = set(rig.names)
    return [
        Problem(
            BONES_INVALID,
            f"The character has no bone {printable(bone)}, which the table names for {joint}.",
            file=name,
            hint=f"Bones are {listed_names([rig.names[n] for n in rig.bones])}.",
        )
        for joint, bone in stated.items()
        if bone is not None and bone not in known
    ]


def _wrong(rig: CharacterRig, joints: Mapping[str, int], name: str) -> list[Problem]:
    """Problems of bones by joint: missing ones, and limbs that don't hang together."""
    rig, _ = connected(rig, joints)
    missing = [joint for joint in bone_names.REQUIRED if joint not in joints]
    if len(missing) == len(bone_names.REQUIRED):
        hint = "Export the mesh together with its skeleton (armature); a mesh without one has to be rigged first."
        return [Problem(CHARACTER_BONES, "The file has no skeleton of a person.", file=name, hint=hint)]
    if missing:
        return [
            Problem(
                CHARACTER_BONES,
                f"No bone of the character was recognised as {listed_names(missing)}.",
                file=name,
                hint="State them by a table of bones (`bones`, or --bones), see `multicap help own-character`.",
            )
        ]
    wrong = []
    for limb in bone_names.LIMBS:
        for above, below in itertools.pairwise(limb):
            if joints[above] == joints[below] or not rig.path(joints[above], joints[below]):
                bones = f"{rig.names[joints[below]]} ({below}) is not below {rig.names[joints[above]]} ({above})"
                wrong.append(Problem(CHARACTER_BONES, f"The bone {bones}.", file=name, hint=_CHAIN_HINT))
    if not wrong and rig.common_ancestor(*(joints[joint] for joint in bone_names.REQUIRED)) is None:
        wrong.append(Problem(CHARACTER_BONES, "The bones of the body do not hang together.", file=name))
    return wrong


def _completed(
    method: Literal["vrm", "names", "shape"],
    rig: CharacterRig,
    joints: Mapping[str, int],
    stated: Mapping[str, str | None],
) -> BoneMapping:
    """Mapping with the bones of the trunk, and those that share the twist of limbs."""
    own = rig
    rig, moved = connected(rig, joints)
    arms = [joints[f"{side}Arm"] for side in bone_names.SIDES]
    hips = (
        joints[bone_names.HIPS]
        if stated.get(bone_names.HIPS) is not None
        else rig.common_ancestor(*(joints[joint] for joint in bone_names.REQUIRED))
    )
    chest = rig.common_ancestor(*arms, joints[bone_names.HEAD])
    if hips is None or chest is None:  # Excluded by ``_wrong``.
        raise ValueError("the bones have no common ancestor")
    spine, neck = rig.path(hips, chest)[1:], rig.path(chest, joints[bone_names.HEAD])[1:-1]
    of_joints = {
        bone_names.HIPS: hips,
        **{joint: joints[joint] for joint in (*bone_names.REQUIRED, *bone_names.OPTIONAL) if joint in joints},
    }
    twists = _twists(rig, of_joints)
    used = {*of_joints.values(), *spine, *neck, *twists}
    # Hips are where the limbs and the head meet in the tree.
    recognised: dict[str, Recognition] = {joint: "shape" if joint == bone_names.HIPS else method for joint in of_joints}
    return BoneMapping(
        "table" if stated else method,
        {joint: rig.names[node] for joint, node in of_joints.items()},
        recognised | {joint: "table" for joint, bone in stated.items() if bone is not None},
        tuple(rig.names[node] for node in spine),
        tuple(rig.names[node] for node in neck),
        {rig.names[node]: joint for node, joint in twists.items()},
        tuple(joint for joint in bone_names.OPTIONAL if joint not in of_joints),
        tuple(rig.names[node] for node in rig.bones if node not in used),
        tuple(_hangs_elsewhere(own, rig, joints[joint]) for joint in moved),
    )


def _hangs_elsewhere(own: CharacterRig, rig: CharacterRig, node: int) -> Finding:
    """Finding about an end of a limb that hangs elsewhere in the file."""
    above = int(own.parents[node])
    place = "at the top of the file" if above < 0 else f"on {printable(own.names[above])}"
    end, limb = (printable(rig.names[bone]) for bone in (node, rig.parents[node]))
    message = (
        f"The bone {end} is not below {limb}: it hangs {place}. Its place is animated too, so that it follows the limb."
    )
    return Finding(BONE_HANGS_ELSEWHERE, message, severity="info")


def _twists(rig: CharacterRig, joints: Mapping[str, int]) -> dict[int, str]:
    """Bones that share the twist of the hand along the forearm, with its joint.

    They are on the way from the elbow to the wrist, or named so and children of the forearm.
    """
    found: dict[int, str] = {}
    named = set(bone_names.twist_bones(rig))
    for side in bone_names.SIDES:
        elbow, hand = joints[f"{side}ForeArm"], joints[f"{side}Hand"]
        beside: Sequence[int] = [child for child in rig.children[elbow] if child in named]
        for node in (*rig.path(elbow, hand)[1:-1], *beside):
            found[node] = f"{side}Hand"
    return found
