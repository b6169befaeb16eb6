"""Bones of armatures by joint, and problems that a user can understand."""

import pytest

from api.blender.extension.bone_tree import BoneTree, add_trunk, bone_problems, recognise_bones
from pipeline.export.character.bone_names import HIPS, REQUIRED
from pipeline.export.character.gltf_reader import decode_character
from pipeline.export.character.mapping import map_bones
from tests.pipeline.export.character.characters import bones_of, character, odd_bones


def read_tree(rig: str) -> BoneTree:
    bones = odd_bones() if rig == "odd" else bones_of(rig)
    names = tuple(bones)
    return BoneTree(names, tuple(-1 if parent is None else names.index(parent) for parent, *_ in bones.values()))


@pytest.mark.parametrize("rig", ["default", "mixamo", "game_engine"])
def test_bones_equal_those_service_recognises(rig: str) -> None:
    expected = map_bones(decode_character("a.glb", character(bones_of(rig))))
    tree = read_tree(rig)
    found = recognise_bones(tree)
    assert bone_problems(tree, found) == []
    assert found == expected.bones
    mapped = add_trunk(tree, found)
    assert (mapped.spine, mapped.neck) == (expected.spine, expected.neck)


def test_rigify_s_metarig() -> None:
    """Bones of the metarig `Basic Human`: names and parents as Blender has them."""
    limbs = [("upper_arm", "shoulder"), ("forearm", "upper_arm"), ("hand", "forearm"), ("shoulder", "spine.003")]
    limbs += [("thigh", "spine"), ("shin", "thigh"), ("foot", "shin"), ("toe", "foot"), ("heel.02", "foot")]
    trunk = ["spine", "spine.001", "spine.002", "spine.003", "spine.004", "spine.005", "spine.006"]
    bones: dict[str, str | None] = dict(zip(trunk, [None, *trunk], strict=False))
    for side in "LR":
        bones |= {f"{bone}.{side}": top if top in bones else f"{top}.{side}" for bone, top in limbs}
    names = tuple(bones)
    tree = BoneTree(names, tuple(-1 if top is None else names.index(top) for top in bones.values()))
    found = recognise_bones(tree)
    assert (found["LeftForeArm"], found["RightToeBase"]) == ("forearm.L", "toe.R")
    (problem,) = bone_problems(tree, found)
    assert "Head" in problem
    head = found | {"Head": "spine.006", HIPS: "spine"}
    assert bone_problems(tree, head) == []
    assert add_trunk(tree, head).spine == ("spine.001", "spine.002", "spine.003")
    assert add_trunk(tree, head).neck == ("spine.004", "spine.005")


def test_wrong_bones_are_reported() -> None:
    tree = read_tree("odd")
    (missing,) = bone_problems(tree, recognise_bones(tree))
    assert all(joint in missing for joint in REQUIRED)
    mixamo = read_tree("mixamo")
    bones = recognise_bones(mixamo)
    (twice,) = bone_problems(mixamo, bones | {"LeftHand": bones["LeftForeArm"]})
    assert bones["LeftForeArm"] in twice
    parents = list(mixamo.parents)
    parents[mixamo.names.index(bones["LeftFoot"])] = mixamo.names.index(bones["Hips"])
    (broken,) = bone_problems(BoneTree(mixamo.names, tuple(parents)), bones)
    assert f"{bones['LeftFoot']} is not below {bones['LeftLeg']}" in broken
    (unknown,) = bone_problems(mixamo, bones | {"LeftHand": "no such bone"})
    assert "no such bone" in unknown


def test_characters_that_rigify_generated_are_refused() -> None:
    tree = BoneTree(("root", "MCH-torso.parent", "DEF-spine"), (-1, 0, 0))
    (problem,) = bone_problems(tree, {})
    assert "metarig" in problem
