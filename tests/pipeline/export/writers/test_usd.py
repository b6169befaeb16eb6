"""USD files, evaluated by UsdSkel and checked by the validators of ``usdchecker``."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Camera
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.file_formats import Export
from pipeline.export.results import write_files, write_results
from pipeline.export.scene import take_scene
from pipeline.export.writers.body_mesh import BodyChoice
from pipeline.geometry.camera import center_in_world
from pipeline.motion.body import installed
from pipeline.motion.body.shape import shape_body
from pipeline.motion.skeleton.model import INDEX, SKELETON, find_skeleton, forward_kinematics
from tests.e2e.foreign import read_take_with_blender
from tests.pipeline.export.test_timelines import NUM_FRAMES, RATE_HZ, joints_m, nearest_m, two_people
from tests.pipeline.export.writers.test_bvh import MOTIONS, walk, with_fingers
from tests.pipeline.motion.body.conftest import in_pose
from tests.pipeline.motion.skeleton.hands.people import gesturing

pytest.importorskip("pxr", reason="usd-core is not installed (the extra `usd`)")

from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdValidation, Vt

from pipeline.export.writers import usd

USD: tuple[Export, ...] = ("usd",)
__all__ = ["two_people"]


def opened(content: Iterator[bytes], path: Path) -> Any:
    path.write_bytes(b"".join(content))
    return Usd.Stage.Open(str(path))


def faults(stage: Any) -> list[str]:
    """Messages of all validators that come with USD."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    return [
        f"{error.GetName()}: {error.GetMessage()}"
        for error in UsdValidation.ValidationContext(validators).Validate(stage)
    ]


def people_in(stage: Any) -> list[Any]:
    return [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)]


def places_m(stage: Any, person: Any) -> np.ndarray:
    """World positions (frames, joints, 3) of a person's joints by UsdSkel, in all frames of a file."""
    query = UsdSkel.Cache()
    query.Populate(UsdSkel.Root(person), Usd.TraverseInstanceProxies())
    (skeleton,) = (prim for prim in Usd.PrimRange(person) if prim.IsA(UsdSkel.Skeleton))
    found = []
    for frame in range(int(stage.GetStartTimeCode()), int(stage.GetEndTimeCode()) + 1):
        transforms = query.GetSkelQuery(UsdSkel.Skeleton(skeleton)).ComputeJointWorldTransforms(
            UsdGeom.XformCache(frame)
        )
        found.append(np.array(transforms)[:, 3, :3])
    return np.array(found)


@MOTIONS
@pytest.mark.parametrize(("num_frames", "rate_hz"), [(1, 25.0), (2, 120000 / 1001), (700, 30000 / 1001)])
def test_takes_of_any_length_and_rate(
    dressed: Callable[[SkeletonMotion], SkeletonMotion], num_frames: int, rate_hz: float, tmp_path: Path
) -> None:
    motion, path = dressed(walk(num_frames, rate_hz)), tmp_path / "person.usdc"
    stage = opened(usd.encode(motion, np.zeros(3)), path)
    assert faults(stage) == []
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 1.0)
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == rate_hz
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, num_frames - 1.0)
    (person,) = people_in(stage)
    assert stage.GetDefaultPrim() == person
    expected_m = forward_kinematics(motion)
    np.testing.assert_allclose(places_m(stage, person), expected_m, atol=1e-5)
    np.testing.assert_allclose(np.concatenate(list(usd.read_xyz_m(path))), expected_m, atol=1e-5)


@MOTIONS
def test_body_is_bound_to_t_pose_on_floor(dressed: Callable[[SkeletonMotion], SkeletonMotion], tmp_path: Path) -> None:
    motion = dressed(walk(5))
    stage = opened(usd.encode(motion, np.zeros(3)), tmp_path / "person.usdc")
    (skeleton,) = (UsdSkel.Skeleton(prim) for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton))
    joints = [path.rpartition("/")[2] for path in skeleton.GetJointsAttr().Get()]
    assert joints == [joint.name for joint in find_skeleton(len(motion.bone_length_m))]
    bind = np.array(skeleton.GetBindTransformsAttr().Get())
    np.testing.assert_array_equal(bind[:, :3, :3], np.tile(np.eye(3), (len(joints), 1, 1)))
    rest_m = bind[:, 3, :3]
    parents = [INDEX[joint.parent] if joint.parent else None for joint in find_skeleton(len(joints))]
    local = np.array(skeleton.GetRestTransformsAttr().Get())[:, 3, :3]
    for index, parent in enumerate(parents):
        above_m = 0.0 if parent is None else rest_m[parent]
        np.testing.assert_allclose(local[index], rest_m[index] - above_m, atol=1e-12)
    assert rest_m[:, 2].min() == pytest.approx(0.0)
    arms_m = rest_m[[INDEX[f"{side}{part}"] for side in ("Left", "Right") for part in ("Arm", "ForeArm", "Hand")]]
    np.testing.assert_allclose(arms_m[:, 2], arms_m[0, 2])
    assert arms_m[2, 0] > 0.3 > -0.3 > arms_m[5, 0]
    assert rest_m[INDEX["LeftFootEnd"], 1] < rest_m[INDEX["LeftFoot"], 1] - 0.05  # it faces -Y
    for frame, pose_m in enumerate(forward_kinematics(motion)):
        moved_m = skinned_m(stage, frame)
        # The body is about its joints: each is near its surface.
        assert np.linalg.norm(moved_m[:, None] - pose_m[None], axis=-1).min(0).max() < 0.2
        assert np.linalg.norm(moved_m.mean(0) - pose_m.mean(0)) < 0.3
    (body,) = (UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    (material, _) = UsdShade.MaterialBindingAPI(body.GetPrim()).ComputeBoundMaterial()
    assert material.ComputeSurfaceSource()[0].GetIdAttr().Get() == "UsdPreviewSurface"


def skinned_m(stage: Any, frame: int) -> np.ndarray:
    """World positions of a body's vertices in a frame, moved by UsdSkel."""
    (person,) = people_in(stage)
    (skeleton,) = (UsdSkel.Skeleton(prim) for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton))
    (body,) = (UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(person), Usd.TraverseInstanceProxies())
    points = Vt.Vec3fArray(body.GetPointsAttr().Get())
    transforms = cache.GetSkelQuery(skeleton).ComputeSkinningTransforms(frame)
    assert cache.GetSkinningQuery(body.GetPrim()).ComputeSkinnedPoints(transforms, points, frame)
    return np.array(points)


@pytest.mark.parametrize("motion", [gesturing(12), walk(12)], ids=["fingers", "no fingers"])
def test_human_bends_as_skeleton_does(motion: SkeletonMotion, tmp_path: Path) -> None:
    installed.install()
    path = tmp_path / "person.usdc"
    stage = opened(usd.encode(motion, np.zeros(3), body=BodyChoice("human")), path)
    assert faults(stage) == []
    np.testing.assert_allclose(np.concatenate(list(usd.read_xyz_m(path))), forward_kinematics(motion), atol=1e-5)
    body = shape_body(installed.load(), motion.bone_length_m)
    for frame in (0, 11):
        vertices_m, _ = in_pose(body, motion.parent_from_joint[frame], motion.root_m[frame])
        np.testing.assert_allclose(skinned_m(stage, frame), vertices_m, atol=2e-5)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("José  Peña 2", "Jose_Pena_2"),
        ("撮影", "person_3"),
        ("撮影-1", "_1"),
        ('a "b" / \\ c', "a_b_c"),
        ("7", "_7"),
        ("  ", "person_3"),
        ("../x", "x"),
        ("😀\n\t", "person_3"),
    ],
)
def test_names_become_identifiers_and_are_shown(name: str, expected: str, tmp_path: Path) -> None:
    motion, path = replace(walk(2), track_id=3, name=name, start_frame=7), tmp_path / "person.usdc"
    stage = opened(usd.encode(motion, np.zeros(3)), path)
    assert faults(stage) == []
    (person,) = people_in(stage)
    assert person.GetName() == expected
    assert Sdf.Path.IsValidIdentifier(person.GetName())
    assert person.GetDisplayName() == name
    assert stage.GetRootLayer().customLayerData["start_frame"] == 7
    assert len(np.concatenate(list(usd.read_xyz_m(path)))) == 2


def test_same_motion_gives_same_bytes() -> None:
    assert b"".join(usd.encode(walk(5), np.zeros(3))) == b"".join(usd.encode(walk(5), np.zeros(3)))


def test_values_are_saved_piece_by_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    motion, path = with_fingers(walk(1500)), tmp_path / "person.usdc"
    monkeypatch.setattr(usd, "_PENDING_BYTES", 2**18)
    path.write_bytes(b"".join(usd.encode(motion, np.zeros(3))))
    np.testing.assert_allclose(np.concatenate(list(usd.read_xyz_m(path))), forward_kinematics(motion), atol=1e-5)


@pytest.mark.parametrize("fault", ["cut off", "no USD", "empty"])
def test_damaged_files_are_no_motion(fault: str, tmp_path: Path) -> None:
    path = tmp_path / "person.usdc"
    content = b"".join(usd.encode(walk(20), np.zeros(3)))
    path.write_bytes({"cut off": content[: len(content) // 2], "no USD": b"x" * 1000, "empty": b""}[fault])
    with pytest.raises(OSError, match=r"person\.usdc"):
        list(usd.read_xyz_m(path))


@pytest.fixture(scope="module")
def named(two_people: Reconstruction) -> Reconstruction:
    """The take with two people of one name, and a camera with its axis aside and pixels that are no squares."""
    camera, *others = two_people.cameras
    matrix = np.array([[900.0, 0.0, 700.0], [0.0, 950.0, 300.0], [0.0, 0.0, 1.0]])
    aside = replace(camera, name="Süd 1", matrix=matrix, distortion=np.array([0.1, 0.0, 0.0, 0.0]))
    motions = tuple(replace(motion, name="Zoë K.") for motion in two_people.motions)
    return replace(two_people, animation=replace(two_people.animation, motions=motions), cameras=(aside, *others))


@pytest.fixture(scope="module")
def path(named: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    paths = write_results(named, tmp_path_factory.mktemp("usd"), USD)
    assert [path.name for path in paths] == [
        "person-1.usdc",
        "person-2.usdc",
        "skeletons.json",
        "take.usdc",
        "metrics.json",
    ]
    return paths[3]


def test_take_has_everybody_on_one_timeline(two_people: Reconstruction, named: Reconstruction, path: Path) -> None:
    stage = Usd.Stage.Open(str(path))
    assert faults(stage) == []
    assert stage.GetDefaultPrim().GetPath() == "/take"
    assert (stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (NUM_FRAMES - 1, RATE_HZ)
    people = people_in(stage)
    assert [str(person.GetPath()) for person in people] == ["/take/people/Zoe_K", "/take/people/Zoe_K_2"]
    for number, (person, plain) in enumerate(zip(people, ("person-1", "person-2"), strict=True)):
        assert person.GetDisplayName() == "Zoë K."
        expected_m = nearest_m(two_people)[plain]
        np.testing.assert_allclose(places_m(stage, person), expected_m, atol=1e-5)
        np.testing.assert_allclose(np.concatenate(list(usd.read_xyz_m(path, number))), expected_m, atol=1e-5)
        (body,) = (prim for prim in Usd.PrimRange(person) if prim.IsA(UsdGeom.Mesh))
        shown = [UsdGeom.Imageable(body).ComputeVisibility(frame) != "invisible" for frame in range(NUM_FRAMES)]
        np.testing.assert_array_equal(shown, np.isfinite(joints_m(two_people)[plain]).any((1, 2)))
    check = json.loads(path.with_name("metrics.json").read_bytes())["exports"]["usd"]
    assert check["max_distance_mm"] < 0.1


def test_cameras_see_what_cameras_of_take_see(named: Reconstruction, path: Path) -> None:
    """Points project to the same places of the picture."""
    stage = Usd.Stage.Open(str(path))
    found = [UsdGeom.Camera(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
    assert found[0].GetPath() == "/take/cameras/Sud_1"
    for camera, prim in zip(named.cameras, found, strict=True):
        assert prim.GetPrim().GetDisplayName() == camera.name
        facts = prim.GetPrim().GetCustomDataByKey("calibration")
        assert list(facts["size_px"]) == list(camera.size_px)
        assert list(facts["distortion"]) == camera.distortion.tolist()
        seen = prim.GetCamera(0)
        np.testing.assert_allclose(seen.frustum.GetPosition(), center_in_world(camera), atol=1e-6)
        to_picture = np.array(seen.frustum.ComputeViewMatrix() * seen.frustum.ComputeProjectionMatrix())
        point_m = named.motions[0].root_m[0]
        across, upright, _, depth = np.append(point_m, 1.0) @ to_picture
        width, height = camera.size_px
        picture_px = [(across / depth + 1) / 2 * width - 0.5, (1 - upright / depth) / 2 * height - 0.5]
        np.testing.assert_allclose(picture_px, pinhole_px(camera, point_m), atol=1e-2)


def pinhole_px(camera: Camera, point_m: np.ndarray) -> np.ndarray:
    x, y, z = camera.matrix @ camera.cam_from_world.apply(point_m)
    return np.array([x / z, y / z])


def test_floor_is_where_people_stand(named: Reconstruction, path: Path) -> None:
    stage = Usd.Stage.Open(str(path))
    floor = UsdGeom.Mesh(stage.GetPrimAtPath("/take/floor/Surface"))
    np.testing.assert_allclose(np.array(floor.GetPointsAttr().Get()), take_scene(named).floor_m, atol=1e-5)


@pytest.mark.blender
def test_take_in_blender(two_people: Reconstruction, named: Reconstruction, path: Path, tmp_path: Path) -> None:
    cameras = [replace(camera, name=usd.identifier(camera.name)) for camera in named.cameras]
    read = read_take_with_blender(path, RATE_HZ, tmp_path, cameras)
    assert set(read["people"]) == {"Zoe_K", "Zoe_K_2"}
    for name, plain in (("Zoe_K", "person-1"), ("Zoe_K_2", "person-2")):
        expected_m = nearest_m(two_people)[plain]
        for joint in SKELETON:
            found_m = np.array(read["people"][name][joint.name])
            np.testing.assert_allclose(found_m, expected_m[:, INDEX[joint.name]], atol=1e-4)
    assert set(read["cameras"]) == {camera.name for camera in cameras}
    for camera in cameras:
        found = read["cameras"][camera.name]
        matrix = np.array(found["matrix"])
        np.testing.assert_allclose(matrix[:3, 3], center_in_world(camera), atol=1e-5)
        np.testing.assert_allclose(-matrix[:3, 2], camera.cam_from_world.rotation[2], atol=1e-5)
        assert found["focal_px"] == pytest.approx(np.diag(camera.matrix)[:2], rel=1e-4)


def test_person_who_comes_later_is_held_and_hidden(two_people: Reconstruction, path: Path) -> None:
    stage = Usd.Stage.Open(str(path.with_name("person-2.usdc")))
    (person,) = people_in(stage)
    np.testing.assert_allclose(places_m(stage, person), nearest_m(two_people)["person-2"], atol=1e-5)
    shown = [UsdGeom.Imageable(person).ComputeVisibility(frame) != "invisible" for frame in range(NUM_FRAMES)]
    np.testing.assert_array_equal(shown, np.isfinite(joints_m(two_people)["person-2"]).any((1, 2)))
    first = Usd.Stage.Open(str(path.with_name("person-1.usdc")))
    assert not UsdGeom.Imageable(people_in(first)[0]).GetVisibilityAttr().IsAuthored()


def test_take_whose_file_is_cut_off_is_no_result(
    named: Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encode = usd.encode_take

    def cut(*arguments: Any) -> Iterator[bytes]:
        content = b"".join(encode(*arguments))
        yield content[: len(content) * 2 // 3]

    monkeypatch.setattr(usd, "encode_take", cut)
    with pytest.raises(OSError, match=r"take\.usdc"):
        write_files(named, tmp_path, USD)
    assert not (tmp_path / "take.usdc").exists()
