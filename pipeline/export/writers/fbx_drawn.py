"""Visible objects of FBX files: meshes, their materials, and cameras."""

import json
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.export.presets import Convention
from pipeline.export.scene import Rgb, SceneCamera
from pipeline.export.writers import fbx_scene
from pipeline.export.writers.euler import euler_deg
from pipeline.export.writers.fbx_nodes import Int64, Node, array

_MESH = "Mesh"
# Distances between which programs show what a camera sees.
_NEAR_M, _FAR_M = 0.05, 1000.0
# Film of cameras, whose unit is an inch; the angle of view follows from the focal length. For the longer side of a
# picture Blender takes the film's width, three.js 35 mm.
_FILM_MM, _MM_PER_INCH, _FOCAL_LENGTH_MODE = 35.0, 25.4, 3
# Side of the picture that the film fits: none, or the height
_FIT_NONE, _FIT_VERTICAL = 0, 1
# Cameras of FBX look along x, with y up.
_CV_FROM_FBX_CAMERA = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True, slots=True)
class DrawnMesh:
    """Ids of a mesh."""

    model: Int64
    geometry: Int64


def add_mesh(
    scene: fbx_scene.FbxScene,
    name: str,
    vertices: Float[np.ndarray, "vertices 3"],
    polygons: Int[np.ndarray, "polygons corners"],
    normals: Float[np.ndarray, "vertices 3"],
    uv: Float[np.ndarray, "vertices 2"] | None = None,
) -> DrawnMesh:
    """Add a mesh; ``polygons`` are indices of ``vertices``, counterclockwise from outside.

    ``uv`` are places in the picture of a material, from its lower left corner; ``None``: there are none.
    """
    corners = polygons.copy()
    corners[:, -1] = ~corners[:, -1]  # The last corner of each polygon is marked so.
    pictured: tuple[Node, ...] = ()
    if uv is not None:
        places = Node("UV", (array("d", uv[polygons].reshape(-1)),))
        pictured = (_layer_element("LayerElementUV", 101, "ByPolygonVertex", "Direct", places),)
    model = scene.add_model(name, _MESH, fbx_scene.SCENE, fbx_scene.visible(True))
    geometry = scene.add(
        *("Geometry", name, "Geometry", _MESH),
        Node("GeometryVersion", (124,)),
        Node("Vertices", (array("d", vertices.reshape(-1)),)),
        Node("PolygonVertexIndex", (array("i", corners.reshape(-1)),)),
        _layer_element(
            "LayerElementNormal",
            *(102, "ByPolygonVertex", "Direct"),
            Node("Normals", (array("d", normals[polygons].reshape(-1)),)),
        ),
        _layer_element(
            "LayerElementMaterial", *(101, "AllSame", "IndexToDirect"), Node("Materials", (array("i", [0]),))
        ),
        *pictured,
        Node(
            "Layer",
            (0,),
            (
                Node("Version", (100,)),
                *(
                    Node("LayerElement", (), (Node("Type", (kind,)), Node("TypedIndex", (0,))))
                    for kind in ("LayerElementNormal", "LayerElementMaterial", *(node.name for node in pictured))
                ),
            ),
        ),
    )
    scene.connect(geometry, model)
    return DrawnMesh(model, geometry)


def _layer_element(kind: str, version: int, mapping: str, reference: str, *content: Node) -> Node:
    return Node(
        kind,
        (0,),
        (
            Node("Version", (version,)),
            Node("Name", ("",)),
            Node("MappingInformationType", (mapping,)),
            Node("ReferenceInformationType", (reference,)),
            *content,
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class BoundVertices:
    """Vertices that a model moves."""

    model: Int64
    vertices: Int[np.ndarray, " moved"]  # Numbers of the vertices
    weights: Float[np.ndarray, " moved"]
    file_from_model: Float[np.ndarray, "4 4"]  # Transform of the model in the bind pose


def add_skin(scene: fbx_scene.FbxScene, name: str, drawn: DrawnMesh, bound: Iterable[BoundVertices]) -> None:
    """Bind a mesh, whose vertices are in the file's axes, to models."""
    skin = scene.add("Deformer", name, "Deformer", "Skin", Node("Version", (101,)), Node("Link_DeformAcuracy", (50.0,)))
    scene.connect(skin, drawn.geometry)
    for part in bound:
        cluster = scene.add(
            *("Deformer", name, "SubDeformer", "Cluster"),
            Node("Version", (100,)),
            Node("UserData", ("", "")),
            Node("Indexes", (array("i", part.vertices),)),
            Node("Weights", (array("d", part.weights),)),
            Node("Transform", (fbx_scene.matrix(np.linalg.inv(part.file_from_model)),)),
            Node("TransformLink", (fbx_scene.matrix(part.file_from_model),)),
        )
        scene.connect(cluster, skin)
        scene.connect(part.model, cluster)


def add_material(scene: fbx_scene.FbxScene, name: str, rgb: Rgb) -> Int64:
    """Add a matt material of a colour."""
    color = np.array(rgb) / 255.0
    return scene.add(
        *("Material", name, "Material", ""),
        Node("Version", (102,)),
        Node("ShadingModel", ("lambert",)),
        Node("MultiLayer", (0,)),
        fbx_scene.settings(
            fbx_scene.vector("DiffuseColor", color, "Color", ""), fbx_scene.number("DiffuseFactor", 1.0)
        ),
    )


def add_camera(
    scene: fbx_scene.FbxScene, shown: SceneCamera, convention: Convention, origin_m: Float[np.ndarray, " 3"]
) -> None:
    """Add a camera: its place, focal length and film, and the calibration of the lens as a text."""
    name, camera = fbx_scene.safe_name(shown.camera.name), shown.camera
    place = shown.world_from_cam
    turn = convention.file_from_world @ place.rotation @ _CV_FROM_FBX_CAMERA
    (((z_deg, y_deg, x_deg),),) = euler_deg(turn[None, None], fbx_scene.ROTATION_ORDERS[:1], np.zeros((1, 3)))
    (width, height), (f_x, f_y) = camera.size_px, camera.matrix[[0, 1], [0, 1]]
    is_upright = height / f_y > width / f_x
    # The film of an upright picture is a square of which the sides are not seen.
    focal_length_mm = _FILM_MM * (f_y / height if is_upright else f_x / width)
    film_height_mm = focal_length_mm * height / f_y
    across_deg, upright_deg = np.degrees(shown.fov_rad)
    model = scene.add_model(
        *(name, "Camera", fbx_scene.SCENE),
        fbx_scene.local(fbx_scene.TRANSLATION, convention.file_from_xyz_m(place.translation_m - origin_m)),
        fbx_scene.local(fbx_scene.ROTATION, (x_deg, y_deg, z_deg)),
        fbx_scene.setting("calibration", "KString", "", json.dumps(shown.facts), flags="U"),
    )
    lens = scene.add(
        *("NodeAttribute", name, "NodeAttribute", "Camera"),
        fbx_scene.settings(
            fbx_scene.setting("AspectWidth", "double", "Number", float(width)),
            # Of square pixels: programs take the shape of the picture from here.
            fbx_scene.setting("AspectHeight", "double", "Number", float(height * f_x / f_y)),
            fbx_scene.choice("ResolutionMode", 0),
            fbx_scene.choice("ApertureMode", _FOCAL_LENGTH_MODE),
            fbx_scene.choice("GateFit", _FIT_VERTICAL if is_upright else _FIT_NONE),
            fbx_scene.number("FilmWidth", _FILM_MM / _MM_PER_INCH),
            fbx_scene.number("FilmHeight", film_height_mm / _MM_PER_INCH),
            fbx_scene.number("FilmAspectRatio", _FILM_MM / film_height_mm),
            fbx_scene.number("FocalLength", focal_length_mm),
            fbx_scene.number("FieldOfView", across_deg),
            fbx_scene.number("FieldOfViewX", across_deg),
            fbx_scene.number("FieldOfViewY", upright_deg),
            fbx_scene.number("NearPlane", _NEAR_M * convention.units_per_m),
            fbx_scene.number("FarPlane", _FAR_M * convention.units_per_m),
        ),
        Node("TypeFlags", ("Camera",)),
        Node("GeometryVersion", (124,)),
    )
    scene.connect(lens, model)
