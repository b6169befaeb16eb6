"""Characters out of FBX files: the same figure as out of GLB, in any axes and unit; damaged files are refused."""

import tracemalloc
import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.errors import InputError
from pipeline.export.character.fbx.reader import decode_fbx_character
from pipeline.export.character.figure import measure
from pipeline.export.character.gltf_reader import CharacterFile, decode_character
from pipeline.export.character.mapping import map_bones
from pipeline.export.character.retarget import retarget
from pipeline.export.character.rig import MAX_NODES
from pipeline.export.character.writers import character_fbx, character_glb
from pipeline.export.character.writers.character_fbx import MeshPart, mesh_parts
from pipeline.export.character.writers.posed import PosedCharacter, bone_places
from pipeline.export.writers.fbx_drawn import BoundVertices, DrawnMesh, add_material, add_skin
from pipeline.export.writers.fbx_nodes import Int64, Node, array, write
from pipeline.export.writers.fbx_scene import ROTATION, SCENE, TRANSLATION, FbxScene, local, number, vector
from tests.e2e.foreign import read_with_three, read_with_ufbx, validate_with_khronos
from tests.pipeline.export.character.characters import bones_of, character
from tests.pipeline.export.character.fbx.fbx_characters import Z_UP, Settings, fbx_of, oriented, plain, skeleton_of
from tests.pipeline.export.character.takes import take_of
from tests.pipeline.export.character.test_retarget import CHARACTERS, figure
from tests.pipeline.export.character.writers.test_character_files import posed

Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


@cache
def manny() -> CharacterFile:
    """Game engine's rig in metres, Y up, with pictures' places, blended weights and a colour."""
    return decode_character("a.glb", character(bones_of("game_engine"), sole=("foot_l", "foot_r")))


def blended(part: MeshPart) -> MeshPart:
    """Mesh whose vertices two bones move, with places in pictures."""
    others = part.bones[:, :1].copy()
    bones = np.concatenate([part.bones[:, :1], np.roll(others, 6, axis=0)], axis=1)
    weights = np.where(bones[:, :1] == bones[:, 1:], (1.0, 0.0), (0.75, 0.25))
    uv = np.linspace(0.0, 1.0, 2 * len(bones)).reshape(-1, 2)
    return replace(part, bones=read_only(bones), weights=read_only(weights), uv=read_only(uv), rgb=(255, 128, 0))


def same_rest(file: CharacterFile, other: CharacterFile, tolerance: float = 1e-4) -> None:
    """Bones of both files are at the same places."""
    names = [other.rig.names[node] for node in other.rig.bones]
    assert {file.rig.names[node] for node in file.rig.bones} == set(names)
    found = [file.rig.positions[file.rig.names.index(name)] for name in names]
    expected = [other.rig.positions[other.rig.names.index(name)] for name in names]
    np.testing.assert_allclose(found, expected, atol=tolerance)


@pytest.mark.parametrize("name", CHARACTERS)
def test_figure_and_its_motion_are_those_of_glb(name: str) -> None:
    """Written as FBX in centimetres and read again: bones within 0.1 mm at rest and in motion."""
    of_glb = figure(name)
    # The character's height in the file's unit is about 1.7 m.
    unit_m = 0.01 if name in {"mixamo", "odd"} else 1.0
    file = decode_fbx_character("a.fbx", fbx_of(of_glb.file, unit_cm=100.0 * unit_m))
    of_fbx = measure(file, map_bones(file, of_glb.mapping.bones))
    names = [of_glb.rig.names[node] for node in of_glb.rig.bones]
    nodes = [of_fbx.rig.names.index(bone) for bone in names]
    expected = of_glb.positions[list(of_glb.rig.bones)] * unit_m
    np.testing.assert_allclose(of_fbx.positions[nodes], expected, atol=1e-4)
    animation = take_of("walk", "feet", 2.0)
    source = animation.motions[0]
    motions = [retarget(source, shape, animation.floor) for shape in (of_glb, of_fbx)]
    frames, is_present = source.frames, np.ones(len(source.frames), bool)
    first, second = (PosedCharacter(motion, "Ana", frames, is_present, np.zeros(3)) for motion in motions)
    bones = first.bones()
    places_m = bone_places(second, tuple(of_fbx.rig.names.index(of_glb.rig.names[node]) for node in bones), frames)
    np.testing.assert_allclose(places_m, bone_places(first, bones, frames), atol=1e-4)


def test_files_of_ours_are_characters_too() -> None:
    content = posed("game_engine")
    file = decode_fbx_character("a.fbx", b"".join(character_fbx.encode(content)))
    same_rest(file, content.motion.figure.file)


@pytest.mark.parametrize("settings_of", [plain, oriented])
def test_axes_and_units_become_those_of_glb(settings_of: Settings) -> None:
    reference = decode_fbx_character("a.fbx", fbx_of(manny(), settings_of=settings_of, unit_cm=100.0))
    same_rest(reference, manny())
    in_cm = Z_UP_FROM_Y_UP * (100.0, 100.0, 100.0, 1.0)
    turned = fbx_of(manny(), settings_of=settings_of, file_from_rig=in_cm, axes=Z_UP, change=blended)
    file = decode_fbx_character("a.fbx", turned)
    same_rest(file, manny())
    (part,), (expected,) = mesh_parts(file), map(blended, mesh_parts(manny()))
    corners, of_expected = (
        np.sort(shape.positions[shape.triangles].reshape(-1, 9), axis=0) for shape in (part, expected)
    )
    np.testing.assert_allclose(corners, of_expected, atol=1e-6)


def test_mesh_keeps_normals_pictures_weights_and_colour() -> None:
    file = decode_fbx_character("a.fbx", fbx_of(manny(), unit_cm=100.0, change=blended))
    (part,), (expected,) = mesh_parts(file), map(blended, mesh_parts(manny()))
    assert part.rgb == expected.rgb
    assert len(part.positions) == len(expected.positions)
    assert part.uv is not None
    assert expected.uv is not None
    # Vertices are told by their places in pictures, which all differ.
    at, of_expected = np.lexsort(part.uv.T), np.lexsort(expected.uv.T)
    for name in ("positions", "normals", "uv"):
        np.testing.assert_allclose(getattr(part, name)[at], getattr(expected, name)[of_expected], atol=1e-6)
    names = np.array(file.rig.names)[part.bones[at, :2]]
    np.testing.assert_array_equal(names[:, 0], np.array(manny().rig.names)[expected.bones[of_expected, 0]])
    np.testing.assert_allclose(part.weights[at, :2], expected.weights[of_expected], atol=1e-6)
    counter_clockwise = np.cross(*(np.diff(part.positions[part.triangles], axis=1).swapaxes(0, 1)))
    directions = np.einsum("ti,ti->t", counter_clockwise, part.normals[part.triangles].mean(axis=1))
    assert (directions > 0.0).mean() > 0.95


def test_file_saved_in_pose_is_read_at_rest() -> None:
    def bent(name: str, matrix: np.ndarray) -> list[Node]:
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec([0.5, 0.2, 0.0]).as_matrix()
        return list(plain(name, matrix @ pose))

    same_rest(decode_fbx_character("a.fbx", fbx_of(manny(), settings_of=bent, unit_cm=100.0)), manny())
    # A skeleton alone says nothing of its rest pose.
    alone = decode_fbx_character("a.fbx", fbx_of(manny(), settings_of=bent, unit_cm=100.0, has_skin=False))
    with pytest.raises(AssertionError):
        same_rest(alone, manny())


def pivoted() -> tuple[bytes, list[np.ndarray]]:
    """Chain of bones with all settings of places, in each order of rotations, and their matrices to the scene."""
    rng, worlds, models = np.random.default_rng(39), [np.eye(4)], []
    axis = dict(zip("XYZ", np.eye(3), strict=True))

    def shifted(xyz: np.ndarray) -> np.ndarray:
        matrix = np.eye(4)
        matrix[:3, 3] = xyz
        return matrix

    def turned(degrees: np.ndarray, order: str = "XYZ") -> np.ndarray:
        """Rotation about the axes of an order, one after the other."""
        matrix = np.eye(4)
        for letter in order:
            angle = np.radians(degrees["XYZ".index(letter)])
            matrix[:3, :3] = Rotation.from_rotvec(angle * axis[letter]).as_matrix() @ matrix[:3, :3]
        return matrix

    for place, order in enumerate(("XYZ", "XZY", "YZX", "YXZ", "ZXY", "ZYX")):
        names = ["RotationOffset", "RotationPivot", "ScalingOffset", "ScalingPivot", "PreRotation", "PostRotation"]
        values = {
            name: rng.uniform(-9.0, 9.0, 3) * (10.0 if "PreR" in name or "Post" in name else 1.0) for name in names
        }
        place_cm, angles_deg = rng.uniform(-20.0, 20.0, 3), rng.uniform(-90.0, 90.0, 3)
        scale = rng.uniform(0.8, 1.2)
        models.append(
            (
                f"bone {place}",
                (
                    local(TRANSLATION, place_cm),
                    local(ROTATION, angles_deg),
                    vector("Lcl Scaling", [scale] * 3, "Lcl Scaling", "", "A"),
                    number("RotationActive", 1.0),
                    number("RotationOrder", place),
                    *(vector(name, xyz) for name, xyz in values.items()),
                ),
            )
        )
        pivot, scaling_pivot = (shifted(values[name]) for name in ("RotationPivot", "ScalingPivot"))
        factors = [
            shifted(place_cm) @ shifted(values["RotationOffset"]) @ pivot @ turned(values["PreRotation"]),
            turned(angles_deg, order) @ np.linalg.inv(turned(values["PostRotation"])) @ np.linalg.inv(pivot),
            shifted(values["ScalingOffset"])
            @ scaling_pivot
            @ np.diag([scale] * 3 + [1.0])
            @ np.linalg.inv(scaling_pivot),
        ]
        worlds.append(worlds[-1] @ factors[0] @ factors[1] @ factors[2])
    return skeleton_of(models), worlds[1:]


def test_places_follow_rule_of_sdk() -> None:
    content, worlds = pivoted()
    rig = decode_fbx_character("a.fbx", content).rig
    for place, world in enumerate(worlds):
        node = rig.names.index(f"bone {place}")
        np.testing.assert_allclose(rig.positions[node] * 100.0, world[:3, 3], atol=1e-3)
        np.testing.assert_allclose(rig.worlds[node, :3, :3], world[:3, :3], atol=1e-5)


def test_three_puts_bones_where_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.fbx"
    path.write_bytes(pivoted()[0])
    rig = decode_fbx_character("a.fbx", path.read_bytes()).rig
    (read,) = read_with_three([path]).values()
    assert len(read.positions) == 6
    for name, places in read.positions.items():
        np.testing.assert_allclose(places[0] / 100.0, rig.positions[rig.names.index(name)], atol=1e-4, err_msg=name)


@pytest.mark.slow
def test_ufbx_puts_bones_where_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.fbx"
    path.write_bytes(pivoted()[0])
    rig = decode_fbx_character("a.fbx", path.read_bytes()).rig
    (read,) = read_with_ufbx([path]).values()
    for name, places in read.positions.items():
        np.testing.assert_allclose(places[0] / 100.0, rig.positions[rig.names.index(name)], atol=1e-4, err_msg=name)


def test_files_in_motion_are_valid(tmp_path: Path) -> None:
    """The GLB that is written of an FBX character has no fault, and its bones are where they were put."""
    animation = take_of("walk", "feet", 2.0)
    file = decode_fbx_character("a.fbx", fbx_of(manny(), unit_cm=100.0, change=blended))
    source = animation.motions[0]
    motion = retarget(source, measure(file, map_bones(file)), animation.floor)
    content = PosedCharacter(motion, "Ana", source.frames, np.ones(len(source.frames), bool), np.zeros(3))
    path = tmp_path / "a.glb"
    path.write_bytes(b"".join(character_glb.encode(content)))
    issues = validate_with_khronos([path])[path]
    # Places in pictures are of no use without pictures, as the validator remarks.
    counts = [issues[f"num{kind}"] for kind in ("Errors", "Warnings", "Hints")]
    assert counts == [0, 0, 0], issues["messages"]
    names = tuple(file.rig.names[node] for node in content.bones())
    places_m = np.concatenate(list(character_glb.read_xyz(path, names)))
    np.testing.assert_allclose(places_m, bone_places(content, content.bones(), content.frames), atol=1e-4)


def mesh_file(*layers: Node, points: np.ndarray, ends: list[int], clusters: int = 0, **places: object) -> CharacterFile:
    """Character of a few bones, and a mesh of polygons of which the first ``clusters`` bones move all points."""
    scene = FbxScene(30.0, 1.0)
    bones = [
        scene.add_model(f"bone {k}", "LimbNode", SCENE, local(TRANSLATION, (k, 0, 0))) for k in range(max(clusters, 1))
    ]
    above = SCENE if clusters else bones[0]
    model = scene.add_model("cube", "Mesh", above, *(vector(name, xyz) for name, xyz in places.items()))  # type: ignore[arg-type]
    geometry = scene.add(
        *("Geometry", "cube", "Geometry", "Mesh"),
        Node("Vertices", (array("d", points.reshape(-1)),)),
        Node("PolygonVertexIndex", (array("i", ends),)),
        *layers,
    )
    scene.connect(geometry, model)
    for color in ((255, 0, 0), (0, 0, 255)):
        scene.connect(add_material(scene, "paint", color), model)
    bound = [
        BoundVertices(bone, np.arange(len(points)), np.full(len(points), 1.0 + place), np.eye(4))
        for place, bone in enumerate(bones[:clusters])
    ]
    if bound:
        add_skin(scene, "skin", DrawnMesh(model, geometry), bound)
    return decode_fbx_character("a.fbx", b"".join(write(scene.nodes)))


SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]])


def test_polygons_become_triangles_of_their_materials() -> None:
    layer = Node(
        "LayerElementMaterial",
        (0,),
        (Node("MappingInformationType", ("ByPolygon",)), Node("Materials", (array("i", [1, 0]),))),
    )
    red, blue = mesh_parts(mesh_file(layer, points=SQUARE, ends=[0, 1, 2, ~3, 1, 4, ~5]))
    assert (red.rgb, len(red.triangles), blue.rgb, len(blue.triangles)) == ((255, 0, 0), 1, (0, 0, 255), 2)
    np.testing.assert_allclose(blue.positions.max(0), (1, 1, 0), atol=1e-6)
    np.testing.assert_allclose(red.normals, [[0, 0, 1]] * 3, atol=1e-6)


def test_geometry_of_model_has_place_of_its_own() -> None:
    """Mirrored surfaces are turned round, so that they look outwards again."""
    (part,) = mesh_parts(
        mesh_file(
            points=SQUARE,
            ends=[0, 1, 2, ~3],
            GeometricTranslation=(0.0, 0.0, 5.0),
            GeometricScaling=(-2.0, 1.0, 1.0),
        )
    )
    np.testing.assert_allclose(part.positions.min(0), (-2, 0, 5), atol=1e-6)
    np.testing.assert_allclose(part.normals, [[0, 0, 1]] * 4, atol=1e-6)


def test_four_largest_weights_are_kept() -> None:
    file = mesh_file(points=SQUARE, ends=[0, 1, ~2], clusters=6)
    (part,) = mesh_parts(file)
    names = np.array(file.rig.names)[part.bones]
    assert names[0].tolist() == ["bone 5", "bone 4", "bone 3", "bone 2"]
    np.testing.assert_allclose(part.weights[0], np.array([6, 5, 4, 3]) / 18.0, atol=1e-6)


def code_of(content: bytes) -> str:
    with pytest.raises(InputError) as raised:
        decode_fbx_character("a.fbx", content)
    (problem,) = raised.value.problems
    assert problem.file == "a.fbx"
    assert problem.hint
    return problem.code


def bone(name: str, above: Int64, scene: FbxScene, *places: Node) -> Int64:
    return scene.add_model(name, "LimbNode", above, *places)


def test_other_versions_are_named() -> None:
    assert code_of(b"; FBX 7.4.0 project file") == "character_format"
    head = b"Kaydara FBX Binary  \x00\x1a\x00"
    assert code_of(head + (6100).to_bytes(4, "little") + bytes(50)) == "character_format"
    assert code_of(head) == "character_unreadable"
    assert code_of(head + (7400).to_bytes(4, "little")) == "character_unreadable"


@pytest.mark.slow
def test_impossible_input_is_refused() -> None:
    circle = FbxScene(30.0, 100.0)
    first = bone("a", SCENE, circle)
    circle.connect(first, bone("b", first, circle))
    nested = FbxScene(30.0, 100.0)
    above = SCENE
    for _ in range(600):
        above = bone("a", above, nested)
    crowd = FbxScene(30.0, 100.0)
    for _ in range(MAX_NODES + 1):
        bone("a", SCENE, crowd)
    flat = FbxScene(30.0, 100.0)
    bone("a", SCENE, flat, local(TRANSLATION, (1e300, 0, 0)))
    codes = [code_of(b"".join(write(scene.nodes))) for scene in (circle, nested, crowd, flat, FbxScene(30.0, 100.0))]
    assert codes == [
        "character_unreadable",
        "character_unreadable",
        "character_too_large",
        "character_unreadable",
        "character_unreadable",
    ]
    for axes in ({"CoordAxisSign": -1}, {"UpAxis": 7}, {"UpAxis": 0}):
        assert code_of(fbx_of(manny(), axes=axes)) == "character_unreadable"
    with pytest.raises(InputError, match="lacks"):
        mesh_file(points=SQUARE, ends=[0, 1, ~9])


def test_small_files_are_not_large_in_memory() -> None:
    """An array of 72 MiB that is stored in 73 kB, which 20 meshes use, is read twice and refused."""
    scene = FbxScene(30.0, 100.0)
    stored = zlib.compress(bytes(72 << 20))
    points = replace(array("d", np.zeros(99)), length=9 << 20, num_bytes=len(stored), content=lambda: stored)
    geometry = scene.add(
        *("Geometry", "bomb", "Geometry", "Mesh"),
        Node("Vertices", (points,)),
        Node("PolygonVertexIndex", (array("i", [0, 1, ~2]),)),
    )
    for _ in range(20):
        scene.connect(geometry, scene.add_model("a", "Mesh", SCENE))
    bone("b", SCENE, scene)
    content = b"".join(write(scene.nodes))
    tracemalloc.start()
    assert code_of(content) == "character_too_large"
    assert tracemalloc.get_traced_memory()[1] < 900 << 20
    tracemalloc.stop()
