"""Bones of characters, recognised by names, by a VRM's table and by shape, and stated by tables."""

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.export.character.bone_names import OPTIONAL, REQUIRED, BoneName, bone_name, joints_by_name
from pipeline.export.character.bone_shapes import joints_by_shape
from pipeline.export.character.figure import measure
from pipeline.export.character.gltf_reader import CharacterFile, decode_character
from pipeline.export.character.mapping import bone_table, map_bones, read_bone_table
from pipeline.export.character.rig import MAX_NODES
from tests.cases import slow_but
from tests.pipeline.export.character.characters import Bones, bones_of, character, glb, ik_bones, odd_bones, parts, vrm

Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read(bones: Bones) -> CharacterFile:
    return decode_character("a.glb", character(bones))


@pytest.mark.parametrize(
    ("name", "side", "word", "numbers"),
    [
        ("mixamorig:LeftForeArm", "Left", "forearm", ()),
        ("mixamorig9:RightHandIndex1", "Right", "handindex", (1,)),
        ("upperarm_l", "Left", "upperarm", ()),
        ("J_Bip_R_UpperLeg", "Right", "upperleg", ()),
        ("J_Bip_C_Head", "", "head", ()),
        ("LeftLowerArm", "Left", "lowerarm", ()),
        ("DEF-upper_arm.L.001", "Left", "upperarm", (1,)),
        ("CC_Base_L_Thigh", "Left", "thigh", ()),
        ("lShldrBend", "Left", "shldrbend", ()),
        ("upperleg02.R", "Right", "upperleg", (2,)),
        ("Bip01 R Calf", "Right", "calf", ()),
    ],
)
def test_names_of_programs_are_taken_to_pieces(name: str, side: str, word: str, numbers: tuple[int, ...]) -> None:
    assert bone_name(name) == BoneName(side, word, numbers)


def expected(rig: str, side: str) -> dict[str, str]:
    """Bones of one side of MakeHuman's rigs."""
    s, dot = side[0].lower(), side[0]
    fingers = ("Thumb", "Index", "Middle", "Ring", "Pinky")
    match rig:
        case "mixamo":
            joints = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")
            names = {joint: f"mixamorig:{side}{joint}" for joint in joints}
            names |= {f"Hand{f}{n}": f"mixamorig:{side}Hand{f}{n}" for f in fingers for n in (1, 2, 3)}
        case "game_engine":
            words = ("clavicle", "upperarm", "lowerarm", "hand", "thigh", "calf", "foot", "ball")
            joints = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")
            names = {joint: f"{word}_{s}" for joint, word in zip(joints, words, strict=True)}
            names |= {f"Hand{f}{n}": f"{f.lower()}_0{n}_{s}" for f in fingers for n in (1, 2, 3)}
        case _:
            words = ("clavicle", "upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot", "toe1-1")
            joints = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")
            names = {joint: f"{word}.{dot}" for joint, word in zip(joints, words, strict=True)}
            names |= {f"Hand{f}{n}": f"finger{k}-{n}.{dot}" for k, f in enumerate(fingers, 1) for n in (1, 2, 3)}
    return {f"{side}{joint}": name for joint, name in names.items()}


@pytest.mark.parametrize("rig", ["default", "mixamo", "game_engine"])
def test_rigs_are_mapped_by_their_names(rig: str) -> None:
    mapping = map_bones(read(bones_of(rig)))
    assert mapping.method == "names"
    assert mapping.missing == ()
    sides = expected(rig, "Left") | expected(rig, "Right")
    assert {joint: bone for joint, bone in mapping.bones.items() if joint in sides} == sides
    trunk = {
        "default": ("root", "head", tuple(f"spine0{n}" for n in (5, 4, 3, 2, 1)), ("neck01", "neck02", "neck03")),
        "mixamo": (
            "mixamorig:Hips",
            "mixamorig:Head",
            tuple(f"mixamorig:{n}" for n in ("Spine", "Spine1", "Spine2")),
            ("mixamorig:Neck",),
        ),
        "game_engine": ("pelvis", "head", ("spine_01", "spine_02", "spine_03"), ("neck_01",)),
    }[rig]
    assert (mapping.bones["Hips"], mapping.bones["Head"], mapping.spine, mapping.neck) == trunk


LIMB_BONES = ("UpLeg", "Leg", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand")


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        ("Hip Knee Ankle Foot Collar Shoulder Elbow Wrist", "{s}_{bone}"),  # SMPL
        ("Hip Knee Ankle Toes Scapula Shoulder Elbow Wrist", "{bone}_{s}"),  # Advanced Skeleton
    ],
)
def test_bones_are_named_after_joints_at_their_heads(names: str, pattern: str) -> None:
    called = {
        f"mixamorig:{side}{joint}": pattern.format(s=side[0], bone=bone)
        for side in ("Left", "Right")
        for joint, bone in zip(LIMB_BONES, names.split(), strict=True)
    } | {"mixamorig:Head": "Head_M"}
    bones: Bones = {
        called.get(name, name): (parent and called.get(parent, parent), head, tail)
        for name, (parent, head, tail) in bones_of("mixamo").items()
    }
    mapping = map_bones(read(bones))
    assert mapping.method == "names"
    for joint in LIMB_BONES:
        assert mapping.bones[f"Left{joint}"] == called[f"mixamorig:Left{joint}"]


def test_meshes_that_are_called_as_bones_are_none() -> None:
    document, binary = parts(character(bones_of("mixamo")))
    # They are at the top, before all bones.
    document["nodes"] += [{"name": name} for name in ("Head", "Arm_L", "Foot_R")]
    mapping = map_bones(decode_character("a.glb", glb(document, binary)))
    assert [mapping.bones[joint] for joint in ("Head", "LeftArm", "RightFoot")] == [
        f"mixamorig:{joint}" for joint in ("Head", "LeftArm", "RightFoot")
    ]


@pytest.mark.parametrize("rig", ["default", "mixamo", "game_engine"])
def test_shape_tells_what_names_tell(rig: str) -> None:
    file = read(bones_of(rig))
    by_shape, by_name = joints_by_shape(file.rig), joints_by_name(file.rig, {})
    toes = {"LeftToeBase", "RightToeBase"}  # MakeHuman's default rig has all ten; any will do.
    assert {joint: n for joint, n in by_shape.items() if joint not in toes} == {
        joint: n for joint, n in by_name.items() if joint not in toes
    }


@pytest.mark.parametrize("version", ["0.x", "1.0"])
def test_table_of_vrm_counts(version: str) -> None:
    file = decode_character("a.vrm", vrm(version))
    mapping = map_bones(file)
    assert mapping.method == "vrm"
    assert set(REQUIRED) <= mapping.bones.keys()
    assert "LeftHandIndex3" in mapping.bones
    assert mapping.missing == tuple(j for j in OPTIONAL if any(f in j for f in ("Thumb", "Middle", "Ring")))
    # Version 0.x faces -Z; x is to the left of the character.
    x = -1.0 if version == "0.x" else 1.0
    np.testing.assert_allclose(measure(file, mapping).skeleton_from_file, np.array([[x, 0, 0], [0, 0, -x], [0, 1, 0]]))


@pytest.mark.parametrize("ends", [("foot.L",), ("foot.L", "foot.R"), ("wrist.L", "wrist.R")])
@pytest.mark.parametrize("top", [None, "root", "spine01"])
def test_ends_of_limbs_that_hang_elsewhere_keep_their_names(ends: tuple[str, ...], top: str | None) -> None:
    mapping = map_bones(read(ik_bones(dict.fromkeys(ends, top))))
    assert mapping.method == "names"
    assert mapping.bones == map_bones(read(bones_of("default"))).bones
    assert [warning.message.split(":")[0] for warning in mapping.warnings] == [
        f"The bone {end} is not below {'lowerleg01' if 'foot' in end else 'lowerarm01'}{end[-2:]}" for end in ends
    ]


def test_limb_that_is_broken_within_is_named() -> None:
    with pytest.raises(InputError) as raised:
        map_bones(read(ik_bones(dict.fromkeys(("lowerleg01.L", "lowerleg01.R"), "root"))))
    assert [problem.message for problem in raised.value.problems] == [
        f"The bone lowerleg01.{side} ({name}Leg) is not below upperleg01.{side} ({name}UpLeg)."
        for side, name in (("L", "Left"), ("R", "Right"))
    ]


def test_shape_never_contradicts_names() -> None:
    names = {"wrist.L": "grip one", "wrist.R": "grip two"}
    bones = ik_bones({"lowerarm02.L": "spine01"})
    renamed: Bones = {
        names.get(name, name): (parent and names.get(parent, parent), head, tail)
        for name, (parent, head, tail) in bones.items()
    }
    with pytest.raises(InputError, match="recognised as LeftHand, RightHand"):
        map_bones(read(renamed))


def test_robot_with_feet_on_root_and_palms_is_retargeted() -> None:
    """Bones as three.js' RobotExpressive has them."""
    up, out = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    bones: Bones = {"Bone": (None, 0 * up, up)}
    for name, above, height in (
        *(("Trunk", "Bone", 1.0), ("Hips", "Trunk", 1.0), ("Abdomen", "Hips", 1.1), ("Torso", "Abdomen", 1.3)),
        *(("Neck", "Torso", 1.5), ("Head", "Neck", 1.6)),
    ):
        bones[name] = (above, height * up, (height + 0.1) * up)
    for letter, way in (("L", out), ("R", -out)):
        for name, above, x, z in (
            *(("Shoulder", "Torso", 0.05, 1.45), ("UpperArm", "Shoulder", 0.2, 1.45)),
            *(("LowerArm", "UpperArm", 0.45, 1.45), ("Palm2", "LowerArm", 0.7, 1.45), ("Thumb", "LowerArm", 0.7, 1.4)),
            *(("Middle1", "Palm2", 0.8, 1.45), ("UpperLeg", "Trunk", 0.1, 0.95), ("LowerLeg", "UpperLeg", 0.1, 0.5)),
            *(("LowerLeg_end", "LowerLeg", 0.1, 0.1), ("Foot", "Bone", 0.1, 0.1), ("PoleTarget", "Bone", 0.1, 0.5)),
        ):
            place = x * way + z * up - (0.5 * np.array([0, 1.0, 0]) if name == "PoleTarget" else 0.0)
            bones[f"{name}{letter}"] = (above if above in bones else f"{above}{letter}", place, place + 0.05 * way)
    mapping = map_bones(read(bones))
    assert [mapping.bones[f"Right{joint}"] for joint in ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")] == [
        f"{name}R" for name in ("UpperArm", "LowerArm", "Palm2", "UpperLeg", "LowerLeg", "Foot")
    ]
    assert (mapping.bones["Hips"], mapping.spine) == ("Trunk", ("Hips", "Abdomen", "Torso"))
    assert [warning.message.split(".")[0] for warning in mapping.warnings] == [
        f"The bone Foot{side} is not below LowerLeg{side}: it hangs on Bone" for side in "LR"
    ]


def test_odd_names_in_centimetres_with_z_up() -> None:
    file = decode_character("a.glb", character(odd_bones(), unit=100.0, turn=Z_UP))
    mapping = map_bones(file)
    assert mapping.method == "shape"
    assert mapping.missing == ()
    rig = read(bones_of("game_engine")).rig
    odd = {name: f"Knochen {number * 37 % 101:03d}" for number, name in enumerate(bones_of("game_engine"))}
    sides = expected("game_engine", "Left") | expected("game_engine", "Right")
    assert {joint: bone for joint, bone in mapping.bones.items() if joint in sides} == {
        joint: odd[name] for joint, name in sides.items()
    }
    assert mapping.spine == tuple(odd[name] for name in ("spine_01", "spine_02", "spine_03"))
    np.testing.assert_array_equal(measure(file, mapping).skeleton_from_file, np.eye(3))
    assert len(rig.names) == len(file.rig.names)


def test_table_corrects_mapping(tmp_path: Path) -> None:
    file = read(bones_of("mixamo"))
    path = tmp_path / "bones.json"
    path.write_text(json.dumps({"bones": {"LeftShoulder": None, "LeftToeBase": "mixamorig:RightToeBase"}}))
    mapping = map_bones(file, read_bone_table(path))
    assert mapping.method == "table"
    assert mapping.missing == ("LeftShoulder",)
    assert "mixamorig:LeftShoulder" in mapping.at_rest
    assert mapping.bones["LeftToeBase"] == "mixamorig:RightToeBase"
    # Its document can be read as a table again.
    assert map_bones(file, bone_table(mapping.document())).bones == mapping.bones


def test_all_problems_of_table_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        bone_table({"bones": {"Elbow": "a", "LeftArm": 3}})
    assert [problem.code for problem in raised.value.problems] == ["bones_invalid"] * 2
    with pytest.raises(InputError, match="no bone Nobody"):
        map_bones(read(bones_of("mixamo")), {"LeftArm": "Nobody"})
    with pytest.raises(InputError, match="is not below"):
        map_bones(read(bones_of("mixamo")), {"LeftHand": "mixamorig:Head"})
    (tmp_path / "bones.json").write_text("[1")
    with pytest.raises(InputError, match="can't be read"):
        read_bone_table(tmp_path / "bones.json")


@pytest.mark.parametrize("num_children", slow_but([40], [2, 40, MAX_NODES]))
def test_large_trees_are_no_characters(num_children: int) -> None:
    """Looking for a body in them ends: the numbers of pairs of branches that are compared are bounded."""
    nodes: list[dict[str, object]] = []
    for number in range(MAX_NODES):
        below = range(num_children * number + 1, min(num_children * (number + 1) + 1, MAX_NODES))
        nodes.append({"translation": [(-1) ** number, 1, number % 7]} | ({"children": [*below]} if below else {}))
    with pytest.raises(InputError) as raised:
        map_bones(decode_character("a.glb", glb({"nodes": nodes}, b"")))
    assert [problem.code for problem in raised.value.problems] == ["character_bones"]


def test_chair_is_no_character() -> None:
    chair: Bones = {"seat": (None, np.zeros(3), np.array([0.0, 0.0, 0.1]))}
    for number, (x, y) in enumerate(((0.2, 0.2), (-0.2, 0.2), (0.2, -0.2), (-0.2, -0.2))):
        chair[f"leg {number}"] = ("seat", np.array([x, y, 0.0]), np.array([x, y, -0.5]))
    with pytest.raises(InputError) as raised:
        map_bones(read(chair))
    assert {problem.code for problem in raised.value.problems} == {"character_bones"}
    assert "no skeleton of a person" in str(raised.value)


def test_mesh_alone_is_no_character() -> None:
    with pytest.raises(InputError) as raised:
        map_bones(decode_character("a.glb", glb({"nodes": [{"name": "mesh"}]}, b"")))
    (problem,) = raised.value.problems
    assert (problem.code, problem.file) == ("character_bones", "a.glb")
    assert "has no skeleton" in problem.message
    assert "together with its skeleton" in (problem.hint or "")
