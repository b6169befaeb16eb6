"""Files with a whole take: people in step, cameras and floor, read by independent software."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Floor
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.data.rigid import Rigid3
from pipeline.core.options.config import Body
from pipeline.core.options.file_formats import Export
from pipeline.export.results import write_files, write_results
from pipeline.export.scene import TakeScene, take_scene
from pipeline.export.writers import fbx, glb
from pipeline.export.writers.fbx_nodes import read
from pipeline.export.writers.fbx_scene import ticks
from pipeline.export.writers.fbx_stored import StoredScene, numbers, object_name, typed_property
from pipeline.geometry.camera import center_in_world
from pipeline.motion.skeleton.model import INDEX, SKELETON
from tests.e2e.foreign import read_take_with_blender, read_take_with_three, validate_with_khronos
from tests.pipeline.export.test_timelines import (
    NUM_FRAMES,
    RATE_HZ,
    joints_m,
    nearest_m,
    two_people,
    y_up,
)
from tests.pipeline.export.writers.test_fbx import values

GLB: tuple[Export, ...] = ("glb",)
FBX: tuple[Export, ...] = ("fbx",)
__all__ = ["two_people"]


@pytest.fixture(scope="module")
def named(two_people: Reconstruction) -> Reconstruction:
    """The take with a floor that rises along x, a person with a name, and a fisheye camera with its axis aside."""
    first, second = two_people.motions
    camera, *others = two_people.cameras
    matrix = np.array([[900.0, 0.0, 700.0], [0.0, 950.0, 300.0], [0.0, 0.0, 1.0]])
    fisheye = replace(camera, name="Süd 1", matrix=matrix, lens="fisheye", distortion=np.array([0.1, 0.0, 0.0, 0.0]))
    animation = replace(
        two_people.animation, motions=(first, replace(second, name="Zoë K.")), floor=Floor(0.1, 0.05, 0.0)
    )
    return replace(two_people, animation=animation, cameras=(fisheye, *others))


@pytest.fixture(scope="module")
def path(named: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    paths = write_results(named, tmp_path_factory.mktemp("scene"), GLB)
    assert [path.name for path in paths] == [
        "person-1.glb",
        "person-2.glb",
        "skeletons.json",
        "take.glb",
        "metrics.json",
    ]
    return paths[3]


NAMES = {"person-1": "person-1", "Zoë K.": "person-2"}


def test_take_in_three(named: Reconstruction, path: Path) -> None:
    issues = validate_with_khronos([path])[path]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
    read = read_take_with_three(path)
    np.testing.assert_allclose(read["times"], np.arange(NUM_FRAMES) / RATE_HZ, atol=1e-6)
    positions_m = np.array(read["positions"])
    assert len(read["names"]) == 2 * len(SKELETON)
    areas_m2 = np.array(read["areas"])
    for column, (name, numbered) in enumerate(NAMES.items()):
        expected_m = y_up(nearest_m(named)[name])
        for joint in SKELETON:
            (place,) = (
                place
                for place, found in enumerate(zip(read["tops"], read["names"], strict=True))
                if found == (name, joint.name)
            )
            np.testing.assert_allclose(positions_m[:, place], expected_m[:, INDEX[joint.name]], atol=1e-4)
        is_there = np.isfinite(joints_m(named)[numbered]).any((1, 2))
        assert (areas_m2[is_there, column] > 1.0).all()
        assert (areas_m2[~is_there, column] < 1e-6).all()


def test_cameras_in_three(named: Reconstruction, path: Path) -> None:
    found = read_take_with_three(path)["cameras"]
    assert list(found) == [camera.name for camera in named.cameras]
    for camera in named.cameras:
        read = found[camera.name]
        (width, height), (f_x, f_y) = camera.size_px, np.diag(camera.matrix)[:2]
        assert read["fov"] == pytest.approx(2 * np.degrees(np.arctan(height / 2 / f_y)), abs=1e-4)
        assert read["aspect"] == pytest.approx((width / f_x) / (height / f_y), rel=1e-6)
        matrix = np.array(read["matrix"]).reshape(4, 4).T
        np.testing.assert_allclose(matrix[:3, 3], y_up(center_in_world(camera)), atol=1e-6)
        right, down, forward = camera.cam_from_world.rotation
        np.testing.assert_allclose(matrix[:3, :3].T, [y_up(right), -y_up(down), -y_up(forward)], atol=1e-6)
    facts = stored(path)["cameras"][0]["extras"]
    assert facts == {
        "size_px": list(named.cameras[0].size_px),
        "focal_length_px": [900.0, 950.0],
        "principal_point_px": [700.0, 300.0],
        "lens": "fisheye",
        "distortion": [0.1, 0.0, 0.0, 0.0],
    }


def stored(path: Path) -> dict[str, list[dict[str, object]]]:
    """Description of a file."""
    content = path.read_bytes()
    described: dict[str, list[dict[str, object]]] = json.loads(
        content[20 : 20 + int.from_bytes(content[12:16], "little")]
    )
    return described


def test_floor_is_where_people_stand(named: Reconstruction, path: Path) -> None:
    box = read_take_with_three(path)["meshes"]["floor"]
    (low_x, low_y, low_z), (high_x, high_y, high_z) = box["min"], box["max"]
    roots_m = np.concatenate([motion.root_m for motion in named.motions])
    np.testing.assert_allclose([low_x, high_x], [roots_m[:, 0].min() - 1.0, roots_m[:, 0].max() + 1.0], atol=1e-5)
    np.testing.assert_allclose([-high_z, -low_z], [roots_m[:, 1].min() - 1.0, roots_m[:, 1].max() + 1.0], atol=1e-5)
    np.testing.assert_allclose([low_y, high_y], [0.1 + 0.05 * low_x, 0.1 + 0.05 * high_x], atol=1e-5)
    level = take_scene(replace(named, animation=replace(named.animation, floor=None)))
    np.testing.assert_array_equal(level.floor_m[:, 2], 0.0)


@pytest.fixture(scope="module")
def fbx_path(named: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    (path,) = (path for path in write_results(named, tmp_path_factory.mktemp("fbx"), FBX) if path.name == "take.fbx")
    return path


# Width and height of pictures, and the camera matrix: wide, upright and square, one with pixels longer than wide, with
# the principal point in the middle or aside.
PICTURES = (
    ((1920, 1080), (1500.0, 1500.0), (959.5, 539.5)),
    ((1080, 1920), (1500.0, 1500.0), (539.5, 959.5)),
    ((1000, 1000), (700.0, 700.0), (430.0, 540.0)),
    ((720, 1280), (900.0, 950.0), (300.0, 700.0)),
    ((1440, 1080), (1200.0, 900.0), (760.0, 500.0)),
    ((640, 480), (400.0, 400.0), (330.0, 250.0)),
)


@pytest.fixture(scope="module")
def mixed(named: Reconstruction) -> Reconstruction:
    """The take with pictures of many shapes."""
    camera, *_ = named.cameras
    cameras = tuple(
        replace(
            camera,
            name=f"Kamera {number}",
            size_px=size_px,
            matrix=np.array([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]]),
        )
        for number, (size_px, (f_x, f_y), (c_x, c_y)) in enumerate(PICTURES, 1)
    )
    return replace(named, cameras=cameras)


@pytest.fixture(scope="module")
def mixed_path(mixed: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mixed") / "take.fbx"
    path.write_bytes(b"".join(fbx.encode_take(take_scene(mixed), "default")))
    return path


@pytest.mark.blender
@pytest.mark.parametrize("importer", ["import_scene.fbx", "wm.fbx_import"])
def test_fbx_cameras_in_blender_have_focal_lengths(
    mixed: Reconstruction, mixed_path: Path, importer: str, tmp_path: Path
) -> None:
    read = read_take_with_blender(mixed_path, RATE_HZ, tmp_path, mixed.cameras, {"importer": importer})["cameras"]
    assert set(read) == {camera.name for camera in mixed.cameras}
    for camera in mixed.cameras:
        assert read[camera.name]["focal_px"] == pytest.approx(np.diag(camera.matrix)[:2], rel=1e-5), camera.name


def test_fbx_cameras_in_three_js_have_focal_lengths(mixed: Reconstruction, mixed_path: Path) -> None:
    read = read_take_with_three(mixed_path)["cameras"]
    assert len(read) == len(mixed.cameras)
    for found, camera in zip(read.values(), mixed.cameras, strict=True):
        (width, height), (f_x, f_y) = camera.size_px, np.diag(camera.matrix)[:2]
        half = np.tan(np.radians(found["fov"]) / 2)
        assert height / 2 / half == pytest.approx(f_y, rel=1e-6), camera.name
        assert width / 2 / (half * found["aspect"]) == pytest.approx(f_x, rel=1e-6), camera.name


def test_fbx_cameras_fit_film_to_longer_side(mixed: Reconstruction, mixed_path: Path) -> None:
    scene = StoredScene(read(mixed_path.read_bytes()))
    for model, camera in zip(scene.find_all("Model", "Camera"), mixed.cameras, strict=True):
        (lens,) = scene.children(model, "NodeAttribute")
        facts = scene.objects[lens]
        focal_mm, width_in, height_in, fit = (
            numbers(facts, name, 1)[0] for name in ("FocalLength", "FilmWidth", "FilmHeight", "GateFit")
        )
        (width, height), (f_x, f_y) = camera.size_px, np.diag(camera.matrix)[:2]
        assert 25.4 * width_in == pytest.approx(35.0)
        is_upright = height / f_y > width / f_x
        assert bool(fit) == is_upright
        # The film's height is the picture's. In an upright picture the film is wider than the picture.
        assert focal_mm / (25.4 * height_in) == pytest.approx(f_y / height)
        assert focal_mm / 35.0 == pytest.approx(f_y / height if is_upright else f_x / width)


@pytest.mark.blender
@pytest.mark.parametrize("format_", ["glb", "fbx"])
def test_take_in_blender(named: Reconstruction, format_: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    path: Path = request.getfixturevalue({"glb": "path", "fbx": "fbx_path"}[format_])
    read = read_take_with_blender(path, RATE_HZ, tmp_path, named.cameras)
    assert set(read["people"]) == set(NAMES)
    for name in NAMES:
        expected_m = nearest_m(named)[name]
        for joint in SKELETON:
            found_m = np.array(read["people"][name][joint.name])
            np.testing.assert_allclose(found_m, expected_m[:, INDEX[joint.name]], atol=1e-4)
    assert set(read["cameras"]) == {camera.name for camera in named.cameras}
    for camera in named.cameras:
        matrix = np.array(read["cameras"][camera.name]["matrix"])
        np.testing.assert_allclose(matrix[:3, 3], center_in_world(camera), atol=1e-5)
        # Objects of FBX files in centimetres have the scale 0.01.
        backward = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        np.testing.assert_allclose(-backward, camera.cam_from_world.rotation[2], atol=1e-5)
        assert read["cameras"][camera.name]["focal_px"] == pytest.approx(np.diag(camera.matrix)[:2], rel=1e-4)
    floor_m = np.array(read["floor"])
    np.testing.assert_allclose(floor_m[:, 2], 0.1 + 0.05 * floor_m[:, 0], atol=1e-5)


def test_our_readers_find_each_person(named: Reconstruction, path: Path, fbx_path: Path) -> None:
    for number, name in enumerate(NAMES):
        for blocks in (glb.read_xyz_m(path, number), fbx.read_xyz_m(fbx_path, "default", number)):
            np.testing.assert_allclose(np.concatenate(list(blocks)), nearest_m(named)[name], atol=1e-5)


def test_fbx_has_cameras_and_shows_who_is_there(named: Reconstruction, fbx_path: Path) -> None:
    scene = StoredScene(read(fbx_path.read_bytes()))
    assert [object_name(node) for node in scene.find_all("Model", "Null").values()] == list(NAMES)
    assert [object_name(node) for node in scene.find_all("AnimationStack", "").values()] == ["take"]
    models = scene.find_all("Model", "Camera")
    for node, camera in zip(models.values(), named.cameras, strict=True):
        assert object_name(node) == camera.name
        place_m = np.array(numbers(node, "Lcl Translation", 3)) / 100.0
        np.testing.assert_allclose(place_m, y_up(center_in_world(camera)), atol=1e-9)
        right, down, forward = camera.cam_from_world.rotation
        # Angles about fixed axes: X first. The camera looks along its x, with y up.
        turn = Rotation.from_euler("xyz", numbers(node, "Lcl Rotation", 3), degrees=True).as_matrix()
        np.testing.assert_allclose(turn.T, [y_up(forward), -y_up(down), y_up(right)], atol=1e-9)
    assert [object_name(node) for node in scene.find_all("Model", "Mesh").values()] == [
        "person-1 body",
        "Zoë K. body",
        "floor",
    ]
    (node,) = (node for node in scene.find_all("AnimationCurveNode", "").values() if object_name(node) == "Visibility")
    (curve,) = scene.children(typed_property(node, 0, int), "AnimationCurve", "d|Visibility")
    keys, shown = (values(scene.objects[curve], name) for name in ("KeyTime", "KeyValueFloat"))
    frames = np.searchsorted(keys, ticks(NUM_FRAMES, RATE_HZ), side="right") - 1
    is_there = np.isfinite(joints_m(named)["person-2"]).any((1, 2))
    np.testing.assert_array_equal(shown[frames].astype(bool), is_there)
    assert len(keys) < 10


def test_take_has_its_frames_whatever_timeline_of_people(named: Reconstruction, path: Path, tmp_path: Path) -> None:
    write_results(named, tmp_path, GLB, timeline="person")
    assert (tmp_path / "take.glb").read_bytes() == path.read_bytes()


def test_person_is_same_in_both_files(named: Reconstruction, path: Path) -> None:
    """Nodes, body and animation of the first person are those of the person's own file."""
    alone, together = stored(path.with_name("person-1.glb")), stored(path)
    num_nodes = len(alone["nodes"])
    assert together["nodes"][:num_nodes] == alone["nodes"]
    assert together["accessors"][: len(alone["accessors"])] == alone["accessors"]
    assert together["meshes"][0] == alone["meshes"][0]


def test_survey_coordinates_have_origin_of_files(named: Reconstruction, tmp_path: Path) -> None:
    away_m = np.array([500_123.4, 5_412_345.6, 312.7])
    cameras = tuple(
        replace(camera, cam_from_world=camera.cam_from_world @ Rigid3(np.eye(3), -away_m)) for camera in named.cameras
    )
    motions = tuple(replace(motion, root_m=motion.root_m + away_m) for motion in named.motions)
    moved = replace(named, cameras=cameras, animation=replace(named.animation, motions=motions))
    write_files(moved, tmp_path, GLB, report=lambda _: {"capture_checks": []})
    check = json.loads((tmp_path / "metrics.json").read_bytes())["exports"]["glb"]
    assert check["max_distance_mm"] < 0.1
    (animation,) = stored(tmp_path / "take.glb")["animations"]
    assert animation["extras"] == {
        "start_frame": 0,
        "frame_rate_hz": RATE_HZ,
        "origin_m": check["origin_m"],
    }
    for node, camera in zip(
        (node for node in stored(tmp_path / "take.glb")["nodes"] if "camera" in node), cameras, strict=True
    ):
        expected_m = y_up(center_in_world(camera) - np.array(check["origin_m"]))
        np.testing.assert_allclose(np.array(node["translation"]), expected_m, atol=1e-6)


def test_take_that_is_too_large_is_left_out_with_warning(
    named: Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert glb.fits(take_scene(named))
    assert not glb.fits(replace(take_scene(named), frames=range(6_000_000)))
    monkeypatch.setattr(glb, "_MAX_BYTES", 2**20)
    paths = write_results(named, tmp_path, GLB)
    assert "take.glb" not in {path.name for path in paths}
    checks = json.loads((tmp_path / "metrics.json").read_bytes())["capture_checks"]
    assert [check["code"] for check in checks if check["code"] == "take_too_large"] == ["take_too_large"]


def test_take_whose_file_is_cut_off_is_no_result(
    named: Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encode = glb.encode_take

    def cut(scene: TakeScene, body: Body) -> Iterator[bytes]:
        content = b"".join(encode(scene, body))
        yield content[: len(content) * 2 // 3]

    monkeypatch.setattr(glb, "encode_take", cut)
    with pytest.raises(OSError, match=r"take\.glb"):
        write_files(named, tmp_path, GLB)
    assert not (tmp_path / "take.glb").exists()
