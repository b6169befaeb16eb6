"""Bones of characters by their names, as programs and exporters call them.

Names of Mixamo, Unreal (mannequins and MetaHuman), VRM, Unity, Rigify, Character Creator, Daz, MakeHuman, 3ds Max
Biped, CMU, SMPL and Maya's Advanced Skeleton come down to a side, a word and numbers. The bones of the trunk have too
many names; they follow from the tree.

This module knows the standard library alone: the extension for Blender has a copy of it.
"""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol, runtime_checkable

SIDES = ("Left", "Right")
HEAD = "Head"
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
"""Fingers of a hand, as ``pipeline.core.joints`` has them."""
HIPS = "Hips"
LIMBS = tuple(
    tuple(f"{side}{joint}" for joint in joints)
    for side in SIDES
    for joints in (("UpLeg", "Leg", "Foot"), ("Arm", "ForeArm", "Hand"))
)
"""Joints of each leg and arm, from the trunk outwards."""
REQUIRED = (HEAD, *(joint for limb in LIMBS for joint in limb))
"""Joints that a character must have."""
OPTIONAL = tuple(f"{side}{joint}" for side in SIDES for joint in ("Shoulder", "ToeBase")) + tuple(
    f"{side}Hand{finger.capitalize()}{number}" for side in SIDES for finger in FINGERS for number in (1, 2, 3)
)
"""Joints that a character may lack."""

# Words in front of names: namespaces, and prefixes of exporters.
_NAMESPACE = re.compile(r"^.*[:|]")
_PREFIX = re.compile(
    r"^(mixamorig\d*|cc_base|rl|def|org|mch|j_bip|j_sec|bip\d*|valvebiped|armature|genesis\d*\w*)[_\-. ]+", re.I
)
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_SIDE_WORDS: Mapping[str, str] = MappingProxyType({"l": "Left", "left": "Left", "r": "Right", "right": "Right"})
# Words of the bones of limbs, side and numbers left out.
_LIMBS: Mapping[str, str] = MappingProxyType(
    {
        word: joint
        for joint, words in {
            "Shoulder": "shoulder clavicle collar collarbone scapula",
            "Arm": "arm upperarm uparm shldr shldrbend armupper",
            "ForeArm": "forearm lowerarm lowarm forearmbend elbow armlower",
            "Hand": "hand wrist",
            "UpLeg": "upleg upperleg thigh thighbend legupper hip",
            "Leg": "leg lowerleg lowleg calf shin knee leglower",
            "Foot": "foot ankle",
            "ToeBase": "toebase toe toes ball",
        }.items()
        for word in words.split()
    }
)
_FINGER_WORDS: Mapping[str, str] = MappingProxyType(
    {"thumb": "thumb", "index": "index", "middle": "middle", "mid": "middle", "ring": "ring", "pinky": "pinky"}
    | {"little": "pinky", "pinkie": "pinky"}
)
_FINGER = re.compile(rf"^(?:hand|f|finger)?({'|'.join(_FINGER_WORDS)})(?:finger)?(.*)$")
# Bones of the palm, and ends of bones, which are no bones of fingers.
_PALM = re.compile(r"metacarpal|carpal|palm")
_END = re.compile(r"(end|nub|tip|effector)$")
_NUM_FINGER_BONES = 3
# Bones of a MetaHuman and of others that are beside the skeleton.
_BESIDE = re.compile(r"twist|roll|ik|pole|target|socket|correct|helper|weapon|prop|ctrl|muscle|adj|share")

VRM_JOINTS: Mapping[str, str] = MappingProxyType(
    {"hips": "Hips", "head": HEAD}
    | {
        f"{side.lower()}{bone}": f"{side}{joint}"
        for side in SIDES
        for bone, joint in {
            "Shoulder": "Shoulder",
            "UpperArm": "Arm",
            "LowerArm": "ForeArm",
            "Hand": "Hand",
            "UpperLeg": "UpLeg",
            "LowerLeg": "Leg",
            "Foot": "Foot",
            "Toes": "ToeBase",
        }.items()
    }
    | {
        f"{side.lower()}{'Little' if finger == 'pinky' else finger.capitalize()}{part}": (
            f"{side}Hand{finger.capitalize()}{number}"
        )
        for side in SIDES
        for finger in FINGERS
        for number, part in enumerate(("Proximal", "Intermediate", "Distal"), 1)
    }
)
"""Joints of the skeleton by the names of VRM's humanoid bones; a thumb with a metacarpal bone is apart."""


@runtime_checkable
class NamedBones(Protocol):
    """Tree of nodes with names, numbered."""

    @property
    def names(self) -> Sequence[str]:
        """Name of each node."""

    @property
    def bones(self) -> Sequence[int]:
        """Numbers of the nodes that move meshes, parents before children; others may be called Head or Arm too."""

    def below(self, number: int, /) -> Sequence[int]:
        """A bone and all bones below it, parents first."""


@dataclass(frozen=True, slots=True)
class BoneName:
    """Name of a bone, taken to pieces."""

    side: str  # ``Left``, ``Right`` or empty
    word: str  # Letters in lower case, without the side
    numbers: tuple[int, ...]


def bone_name(name: str) -> BoneName:
    """Take the name of a bone to pieces.

    >>> bone_name("mixamorig:LeftHandIndex1")
    BoneName(side='Left', word='handindex', numbers=(1,))
    """
    bare = _NAMESPACE.sub("", name)
    while (shorter := _PREFIX.sub("", bare)) != bare:
        bare = shorter
    words = _WORDS.findall(bare)
    sides = [word for word in words if word.lower() in _SIDE_WORDS]
    side = _SIDE_WORDS[sides[0].lower()] if sides else ""
    # VRoid and Advanced Skeleton mark the bones in the middle by C in front and M at the end.
    middle = [word for word, mark in ((words[:1], "C"), (words[-1:], "M")) if word == [mark]]
    left_out = {*sides[:1], *itertools.chain(*middle)}
    letters = "".join(word.lower() for word in words if not word.isdigit() and word not in left_out)
    return BoneName(side, letters, tuple(int(word[:9]) for word in words if word.isdigit()))


def joints_by_name(rig: NamedBones, humanoid: Mapping[str, int]) -> dict[str, int]:
    """Bones of limbs, fingers and the head that their names, or the table of a VRM, tell: nodes by joint.

    Joints are the skeleton's, with ``LeftToeBase`` and ``RightToeBase``.
    """
    found = _by_table(humanoid)
    if found:
        return found
    collars: dict[str, list[int]] = {side: [] for side in SIDES}
    palms: dict[str, int] = {}
    for number in rig.bones:
        name = bone_name(rig.names[number])
        if name.word == "head" and not name.side and HEAD not in found:
            found[HEAD] = number
        if name.word in ("palm", "fist") and name.side:
            palms.setdefault(f"{name.side}Hand", number)
        joint = _LIMBS.get(name.word)
        if joint and name.side and not _BESIDE.search(name.word):
            # Of several bones of a limb, the first one: the others are twisted along.
            found.setdefault(f"{name.side}{joint}", number)
            if joint == "Shoulder":
                collars[name.side].append(number)
            elif name.word == "foot" and found[f"{name.side}Foot"] != number:
                # Names after joints: the foot that follows an ankle begins at the toes.
                found.setdefault(f"{name.side}ToeBase", number)
    for side, bones in collars.items():
        if bones and f"{side}Arm" not in found:
            # Names after joints: the shoulder is where the upper arm begins, behind a collar bone or none.
            found[f"{side}Arm"] = bones[-1]
            if len(bones) == 1:
                del found[f"{side}Shoulder"]
    found = palms | found  # Hands of few bones have no wrist of their own
    for side in SIDES:
        hand = found.get(f"{side}Hand")
        if hand is not None:
            found |= _fingers(rig, side, hand)
    return found


def _by_table(humanoid: Mapping[str, int]) -> dict[str, int]:
    found = {VRM_JOINTS[bone]: node for bone, node in humanoid.items() if bone in VRM_JOINTS}
    for side in SIDES:
        # VRM 1.0 calls the bones of a thumb metacarpal, proximal and distal.
        if f"{side.lower()}ThumbMetacarpal" in humanoid:
            thumb = [f"{side.lower()}Thumb{part}" for part in ("Metacarpal", "Proximal", "Distal")]
            for number in (1, 2, 3):
                found.pop(f"{side}HandThumb{number}", None)
            found |= {f"{side}HandThumb{n}": humanoid[bone] for n, bone in enumerate(thumb, 1) if bone in humanoid}
    return found


def _fingers(rig: NamedBones, side: str, hand: int) -> dict[str, int]:
    chains: dict[str, list[int]] = {}
    for node in rig.below(hand)[1:]:
        if finger := _finger(bone_name(rig.names[node])):
            chains.setdefault(finger, []).append(node)
    return {
        f"{side}Hand{finger.capitalize()}{number}": node
        for finger, chain in chains.items()
        for number, node in enumerate(chain[:_NUM_FINGER_BONES], 1)
    }


def _finger(name: BoneName) -> str | None:
    """Finger that a bone belongs to; ``None`` for bones of palms, and ends."""
    if _PALM.search(name.word) or _END.search(name.word):
        return None
    if matched := _FINGER.match(name.word):
        return _FINGER_WORDS[matched[1]]
    # MakeHuman and Biped number the fingers.
    if name.word == "finger" and name.numbers and len(name.numbers) > 1 and 1 <= name.numbers[0] <= len(FINGERS):
        return FINGERS[name.numbers[0] - 1]
    return None


def twist_bones(rig: NamedBones) -> Iterator[int]:
    """Bones whose names say that they share the twist of a limb."""
    for number, name in enumerate(rig.names):
        if re.search(r"twist|roll", bone_name(name).word):
            yield number
