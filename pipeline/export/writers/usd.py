"""USD files (binary, ``.usdc``): skeletons of UsdSkel with a body as their skin, and their motion as an animation.

A file holds a person, or the scene of a take: everybody, the cameras and the floor.

Axes and unit are the world's: Z up, metres. The rest pose, which is the bind pose too, is a T-pose that stands on the
floor at the origin and faces -Y; joints are aligned with the world's axes there. A time code is a frame: 0 is the first
frame of the file, and there are as many time codes a second as frames. A person is a ``SkelRoot`` with a ``Skeleton``,
a ``SkelAnimation`` with the places and rotations of all joints in each frame, and the body, a ``Mesh``. Before and
after the motion's own frames the nearest pose holds; where the person is not there, the person is invisible.

Prims of people and cameras have their names as identifiers, which are unique, and as display names. Positions of joints
have single precision: if the world's origin is far away, the file's data state the world position in metres,
``origin_m``, that positions are relative to. Points of the user's own are ``Xform`` prims.

Files are written and read by the package ``usd-core``, the extra ``usd``.
"""

import errno
import re
import tempfile
import unicodedata
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel, Vt
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.options.config import Body
from pipeline.export.presets import WORLD, Convention
from pipeline.export.scene import FLOOR, Rgb, SceneCamera, ScenePoint, TakeScene, color_rgb
from pipeline.export.timelines import frame_blocks, held
from pipeline.export.writers.body_mesh import CAPSULES, BodyAtRest, BodyChoice, body_at_rest
from pipeline.export.writers.registry import TakeWriter, Writer
from pipeline.motion.body.joints import TWIST_JOINTS, TwistJoint
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, find_skeleton, parent_indices

# Positions and normals of vertices, and the vertices of each face, counterclockwise from outside.
_Surface = tuple[Float[np.ndarray, "vertices 3"], Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces corners"]]

_CONVENTION = Convention(file_from_world=WORLD, units_per_m=1.0)
_TAKE, _PEOPLE, _CAMERAS = "take", "people", "cameras"
_ORIGIN, _START_FRAME = "origin_m", "start_frame"
_FLOOR_RGB: Rgb = (150, 150, 150)
_GAMMA = 2.2
# Bytes of values that wait in memory until they are saved.
_PENDING_BYTES = 2**26
_PART_BYTES = 2**20
# Width of a camera's film in tenths of a unit, 36 mm.
_FILM = 0.36
_NEAR_M, _FAR_M = 0.05, 1000.0
# Cameras of USD look along -z, with y up.
_CV_FROM_USD_CAMERA = np.diag([1.0, -1.0, -1.0])


def encode(
    motion: SkeletonMotion,
    origin_m: Float[np.ndarray, " 3"],
    frames: range | None = None,
    is_present: Bool[np.ndarray, " frames"] | None = None,
    body: BodyChoice = CAPSULES,
    points: Sequence[ScenePoint] = (),
) -> Iterator[bytes]:
    """Write a motion as USD, piece by piece. Equal motions give equal bytes.

    - ``origin_m``: world position of the file's origin.
    - ``frames``: output frames of the file; ``None``: the motion's frames.
    - ``is_present``: frames of the file in which the person is there; ``None``: all.
    - ``points``: points of the user's own in the frames of the file.
    - Raises ``ModelError`` if the body is a human, and that is not installed or was changed.
    - Raises ``OSError`` if the file can't be written.
    """
    frames = motion.frames if frames is None else frames
    with tempfile.TemporaryDirectory(prefix="multicap-usd-") as folder:
        document = _Document(Path(folder), origin_m, frames, motion.frame_rate_hz)
        path = document.add_person(Sdf.Path.absoluteRootPath, motion, is_present, body)
        document.stage.SetDefaultPrim(document.stage.GetPrimAtPath(path))
        document.add_points(path, points)
        yield from document.encode()


def encode_take(scene: TakeScene, body: Body = "capsules") -> Iterator[bytes]:
    """Write the scene of a take as USD, piece by piece. Equal scenes give equal bytes.

    Raises ``OSError`` if the file can't be written.
    """
    with tempfile.TemporaryDirectory(prefix="multicap-usd-") as folder:
        document = _Document(Path(folder), scene.origin_m, scene.frames, scene.frame_rate_hz)
        take = document.add_group(Sdf.Path.absoluteRootPath, _TAKE, Kind.Tokens.assembly)
        document.stage.SetDefaultPrim(document.stage.GetPrimAtPath(take))
        people = document.add_group(take, _PEOPLE, Kind.Tokens.group)
        cameras = document.add_group(take, _CAMERAS, Kind.Tokens.group)
        document.add_floor(take, scene.floor_m)
        for camera in scene.cameras:
            document.add_camera(cameras, camera)
        for person in scene.people:
            choice = BodyChoice(body, scene.floor)
            document.add_points(document.add_person(people, person.motion, person.is_present, choice), person.points)
        document.add_points(take, scene.objects)
        yield from document.encode()


class _Document:
    """File in a folder, to which people are added."""

    def __init__(self, folder: Path, origin_m: Float[np.ndarray, " 3"], frames: range, frame_rate_hz: float) -> None:
        self._path, self._origin_m, self._frames = folder / "scene.usdc", origin_m, frames
        self._layer = Sdf.Layer.CreateNew(str(self._path))
        self.stage = Usd.Stage.Open(self._layer)
        UsdGeom.SetStageUpAxis(self.stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        self.stage.SetTimeCodesPerSecond(frame_rate_hz)
        self.stage.SetFramesPerSecond(frame_rate_hz)
        self.stage.SetStartTimeCode(0.0)
        self.stage.SetEndTimeCode(len(frames) - 1.0)
        origin = {_ORIGIN: Gf.Vec3d(*origin_m.tolist())} if origin_m.any() else {}
        self._layer.customLayerData = {"creator": "Multicap", _START_FRAME: frames.start, **origin}

    def add_group(self, parent: Any, name: str, kind: str) -> Any:
        """Add a prim that holds others; return its path."""
        path = parent.AppendChild(name)
        Usd.ModelAPI(UsdGeom.Xform.Define(self.stage, path)).SetKind(kind)
        return path

    def add_person(
        self, parent: Any, motion: SkeletonMotion, is_present: Bool[np.ndarray, " frames"] | None, choice: BodyChoice
    ) -> Any:
        """Add the skeleton, the body and the motion of a person; return the path of the person's prim."""
        body = body_at_rest(motion, _CONVENTION, choice)
        path = self._free_path(parent, motion.name, f"person_{motion.track_id}")
        root = UsdSkel.Root.Define(self.stage, path)
        root.GetPrim().SetDisplayName(motion.name)
        root.GetPrim().SetCustomDataByKey("person", motion.track_id)
        Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
        if is_present is not None and not is_present.all():
            _show(root, is_present)

        joints = Vt.TokenArray(joint_paths(len(body.offsets), body.twists))
        skeleton = UsdSkel.Skeleton.Define(self.stage, path.AppendChild("Skeleton"))
        skeleton.CreateJointsAttr(joints)
        skeleton.CreateBindTransformsAttr(_moved(body.positions))
        skeleton.CreateRestTransformsAttr(_moved(np.concatenate([body.offsets, body.twist_offsets])))
        animation = UsdSkel.Animation.Define(self.stage, path.AppendChild("Motion"))
        animation.CreateJointsAttr(joints)
        animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0)] * len(joints)))
        animated = animation.CreateTranslationsAttr().GetPath(), animation.CreateRotationsAttr().GetPath()
        UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])

        mesh = body.mesh
        surface = mesh.vertices, mesh.normals, mesh.triangles
        skin = self._add_mesh(path.AppendChild("Body"), surface, color_rgb(motion.track_id))
        binding = UsdSkel.BindingAPI.Apply(skin.GetPrim())
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
        num_carriers = mesh.joints.shape[1]
        carriers = binding.CreateJointIndicesPrimvar(constant=False, elementSize=num_carriers)
        carriers.Set(_whole_numbers(mesh.joints))
        weights = binding.CreateJointWeightsPrimvar(constant=False, elementSize=num_carriers)
        weights.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(mesh.weights, np.float32).reshape(-1)))
        self._animate(motion, body, *animated)
        return path

    def add_points(self, parent: Any, points: Sequence[ScenePoint]) -> None:
        """Add points of the user's own, invisible where they are unknown; a rigid object has its points below it."""
        for point in points:
            added = UsdGeom.Xform.Define(self.stage, self._free_path(parent, point.name, "point"))
            place = added.AddTranslateOp().GetAttr().GetPath()
            with Sdf.ChangeBlock():
                for frame, xyz_m in enumerate((point.xyz_m - self._origin_m).tolist()):
                    self._layer.SetTimeSample(place, float(frame), Gf.Vec3d(*xyz_m))
            if point.turn_xyzw is not None:
                turn = added.AddOrientOp().GetAttr().GetPath()
                for frame, (x, y, z, w) in enumerate(point.turn_xyzw.tolist()):
                    self._layer.SetTimeSample(turn, float(frame), Gf.Quatf(w, x, y, z))
            for name, place_m in point.parts:
                part = UsdGeom.Xform.Define(self.stage, self._free_path(added.GetPath(), name, "point"))
                part.AddTranslateOp().Set(Gf.Vec3d(*place_m.tolist()))
            if not point.is_known.all():
                _show(added, point.is_known)

    def _free_path(self, parent: Any, name: str, otherwise: str) -> Any:
        """Path of a new prim below another, named as closely to a name as identifiers allow."""
        wanted = identifier(name) or otherwise
        path, number = parent.AppendChild(wanted), 1
        while self._layer.GetPrimAtPath(path):
            number += 1
            path = parent.AppendChild(f"{wanted}_{number}")
        return path

    def _animate(self, motion: SkeletonMotion, body: BodyAtRest, translations: Any, rotations: Any) -> None:
        """Add values of the places and rotations of all joints in each frame, and save them piece by piece."""
        own, frames = motion.frames, self._frames
        offsets_m = np.concatenate([body.offsets, body.twist_offsets]).astype(np.float32)
        pending_bytes = 0
        for rows in frame_blocks(len(frames)):
            turns = held(motion.parent_from_joint, own, frames[rows])
            twists = [_CONVENTION.twist_from_quat(turns, twist)[:, None] for twist in body.twists]
            quat = np.concatenate([turns, *twists], axis=1).astype(np.float32)
            places_m = np.tile(offsets_m, (len(quat), 1, 1))
            places_m[:, 0] = held(motion.root_m, own, frames[rows]) - self._origin_m
            with Sdf.ChangeBlock():
                for row in range(len(quat)):
                    time = float(rows.start + row)
                    self._layer.SetTimeSample(translations, time, Vt.Vec3fArray.FromNumpy(places_m[row]))
                    self._layer.SetTimeSample(rotations, time, Vt.QuatfArray.FromNumpy(quat[row]))
            pending_bytes += quat.nbytes + places_m.nbytes
            if pending_bytes >= _PENDING_BYTES:
                self._save()
                pending_bytes = 0
        self._save()

    def _add_mesh(self, path: Any, surface: _Surface, rgb: Rgb) -> Any:
        vertices, normals, faces = surface
        shape = UsdGeom.Mesh.Define(self.stage, path)
        points = vertices.astype(np.float32)
        shape.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
        shape.CreateFaceVertexCountsAttr(_whole_numbers(np.full(len(faces), faces.shape[1])))
        shape.CreateFaceVertexIndicesAttr(_whole_numbers(faces))
        shape.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
        shape.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        shape.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
        color = Gf.Vec3f(*((np.array(rgb) / 255.0) ** _GAMMA).tolist())
        shape.CreateDisplayColorAttr([color])
        material = UsdShade.Material.Define(self.stage, path.GetParentPath().AppendChild(f"{path.name}Material"))
        shader = UsdShade.Shader.Define(self.stage, material.GetPath().AppendChild("Surface"))
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(color)
        shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.8)
        shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
        material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
        UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(material)
        return shape

    def add_camera(self, parent: Any, shown: SceneCamera) -> None:
        """Add a camera with its film, its place, and the calibration of the lens as data."""
        camera, place = shown.camera, shown.world_from_cam
        path = self._free_path(parent, camera.name, "camera")
        added = UsdGeom.Camera.Define(self.stage, path)
        added.GetPrim().SetDisplayName(camera.name)
        (width, height), ((f_x, _, c_x), (_, f_y, c_y), _) = camera.size_px, camera.matrix.tolist()
        # Lengths on the film for one across a pixel, and for one upright; pixels may be longer than wide.
        focal = _FILM * f_x / width
        added.CreateFocalLengthAttr(focal)
        added.CreateHorizontalApertureAttr(_FILM)
        added.CreateVerticalApertureAttr(focal * height / f_y)
        # The middle of the picture as seen from the principal point, up and to the right.
        added.CreateHorizontalApertureOffsetAttr(focal * ((width - 1) / 2 - c_x) / f_x)
        added.CreateVerticalApertureOffsetAttr(focal * (c_y - (height - 1) / 2) / f_y)
        added.CreateClippingRangeAttr(Gf.Vec2f(_NEAR_M, _FAR_M))
        matrix = np.eye(4)
        matrix[:3, :3] = place.rotation @ _CV_FROM_USD_CAMERA
        matrix[:3, 3] = place.translation_m - self._origin_m
        # Positions are rows there.
        added.AddTransformOp().Set(Gf.Matrix4d(matrix.T))
        for name, value in shown.facts.items():
            added.GetPrim().SetCustomDataByKey(
                f"calibration:{name}", value if isinstance(value, str) else Vt.DoubleArray(value)
            )

    def add_floor(self, parent: Any, corners_m: Float[np.ndarray, "4 3"]) -> None:
        """Add the floor, a quadrilateral with its corners counterclockwise from above."""
        corners_m = corners_m - self._origin_m
        up = np.cross(corners_m[1] - corners_m[0], corners_m[3] - corners_m[0])
        normals = np.tile(up / np.linalg.norm(up), (4, 1))
        group = self.add_group(parent, FLOOR, Kind.Tokens.component)
        surface = corners_m, normals, np.arange(4)[None]
        self._add_mesh(group.AppendChild("Surface"), surface, _FLOOR_RGB).CreateDoubleSidedAttr(True)

    def _save(self) -> None:
        try:
            self._layer.Save()
        except Tf.ErrorException as error:
            raise OSError(errno.EIO, f"USD can't be written: {error}") from error

    def encode(self) -> Iterator[bytes]:
        """Yield the bytes of the file, piece by piece."""
        self._save()
        with self._path.open("rb") as file:
            while part := file.read(_PART_BYTES):
                yield part


def identifier(name: str) -> str:
    """Name of a prim as close to a name as programs of all versions read: ASCII letters, digits and underscores.

    Empty for a name without letters and digits of ASCII, accents aside.

    >>> identifier("Zoë K. 2")
    'Zoe_K_2'
    >>> identifier("7")
    '_7'
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    words = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")
    return f"_{words}" if words[:1].isdigit() else words


def joint_paths(num_joints: int, twists: tuple[TwistJoint, ...] = ()) -> list[str]:
    """Names of joints in the file, of a skeleton and then twist joints: paths from the root, such as ``Hips/Spine``."""
    paths: list[str] = []
    for joint in find_skeleton(num_joints):
        paths.append(f"{paths[INDEX[joint.parent]]}/{joint.name}" if joint.parent else joint.name)
    return paths + [f"{paths[INDEX[twist.parent]]}/{twist.name}" for twist in twists]


def _whole_numbers(numbers: Int[np.ndarray, "rows *columns"]) -> Any:
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(numbers, np.int32).reshape(-1))


def _moved(places: Float[np.ndarray, "joints 3"]) -> Any:
    transforms = np.tile(np.eye(4), (len(places), 1, 1))
    # Positions are rows there.
    transforms[:, 3, :3] = places
    return Vt.Matrix4dArray.FromNumpy(transforms)


def _show(root: Any, is_present: Bool[np.ndarray, " frames"]) -> None:
    """Make a prim visible in some frames, with a value where it changes."""
    visibility = UsdGeom.Imageable(root).CreateVisibilityAttr()
    for frame in np.flatnonzero(np.diff(is_present, prepend=~is_present[0])).tolist():
        visibility.Set(UsdGeom.Tokens.inherited if is_present[frame] else UsdGeom.Tokens.invisible, float(frame))


def read_xyz_m(path: Path, person: int = 0) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of a skeleton's joints from a file, block by block.

    ``person`` is the person's place among the people of a take; a file of one person has one.

    Raises ``OSError`` if the file is no USD or is damaged, or lacks a person, a joint, or values in a frame.
    """
    try:
        stored = _StoredMotion(path, person)
        for rows in frame_blocks(stored.num_frames):
            yield stored.positions_m(rows) + stored.origin_m
    except (Tf.ErrorException, _UsdError) as error:
        raise OSError(errno.EIO, f"{path.name} is damaged: {error}") from error


class _UsdError(Exception):
    """Content that files of this module do not have."""


class _StoredMotion:
    """Motion of a person in a file."""

    def __init__(self, path: Path, person: int) -> None:
        # The stage keeps the layer, of which animations are read.
        self._stage = Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(path)))
        skeletons = [prim for prim in self._stage.Traverse() if prim.IsA(UsdSkel.Skeleton)]
        if person >= len(skeletons):
            raise _UsdError(f"it has {len(skeletons)} skeletons")
        joints = list(UsdSkel.Skeleton(skeletons[person]).GetJointsAttr().Get() or ())
        expected = (
            (num_joints, joint_paths(num_joints, twists))
            for num_joints in (len(SKELETON), len(WHOLE_SKELETON))
            for twists in ((), TWIST_JOINTS)
        )
        num_joints = next((num_joints for num_joints, paths in expected if paths == joints), None)
        if num_joints is None:
            raise _UsdError("the skeleton has other joints")
        animation = UsdSkel.Animation(UsdSkel.BindingAPI(skeletons[person]).GetInheritedAnimationSource())
        if not animation or list(animation.GetJointsAttr().Get() or ()) != joints:
            raise _UsdError("the animation has other joints")
        self._values = animation.GetTranslationsAttr(), animation.GetRotationsAttr()
        self._parents = parent_indices(num_joints).tolist()
        self.num_frames = round(self._stage.GetEndTimeCode() - self._stage.GetStartTimeCode()) + 1
        if any(attribute.GetTimeSamples() != list(range(self.num_frames)) for attribute in self._values):
            raise _UsdError("the animation has values at other times than the frames")
        facts = self._stage.GetRootLayer().customLayerData
        self.origin_m = np.array(facts.get(_ORIGIN, (0.0, 0.0, 0.0)))

    def positions_m(self, rows: slice) -> Float[np.ndarray, "_ joints 3"]:
        """Positions of the skeleton's joints in some frames."""
        frames, joints = range(rows.start, rows.stop), slice(len(self._parents))
        offsets_m, quat = (
            np.array([np.array(attribute.Get(float(frame)))[joints] for frame in frames], np.float64)
            for attribute in self._values
        )
        turns = Rotation.from_quat(quat.reshape(-1, 4)).as_matrix().reshape(*quat.shape[:2], 3, 3)
        places_m = np.empty_like(offsets_m)
        for joint, parent in enumerate(self._parents):
            if not joint:
                places_m[:, 0] = offsets_m[:, 0]
                continue
            places_m[:, joint] = places_m[:, parent] + (turns[:, parent] @ offsets_m[:, joint, :, None])[..., 0]
            turns[:, joint] = turns[:, parent] @ turns[:, joint]
        return places_m


WRITER = Writer(
    lambda person: encode(
        person.motion, person.origin_m, person.frames, person.is_present, person.body, person.scene_points
    ),
    lambda path, _: read_xyz_m(path),
    holds_name=True,
    has_origin=True,
    take=TakeWriter(lambda scene, _, body: encode_take(scene, body), lambda path, _, person: read_xyz_m(path, person)),
)
