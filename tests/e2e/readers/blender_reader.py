"""Program for Blender's Python: bones in every frame of BVH, GLB, FBX and USD files, areas of bodies, and a picture.

    python blender_reader.py JOB.json

``JOB.json`` is ``{"files": [{"path", "frame_rate_hz", "import": {...}}], "out": FILE, "picture": FILE or null}``;
``import`` has settings of the importer, of FBX the name of the ``importer``. ``half_way`` of a file asks for positions
half-way between frames, ``pictures`` for the projection of cameras by name: width, height, and the height of a pixel
by its width. The output is written to ``out``.
"""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
from mathutils import Vector

BACK_M, ABOVE_M, ASIDE_M = 5.2, 1.1, 1.6


def empty(frame_rate_hz: float) -> Any:
    """Empty the scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = math.ceil(frame_rate_hz)
    scene.render.fps_base = math.ceil(frame_rate_hz) / frame_rate_hz
    return scene


def load(path: str, options: Mapping[str, Any]) -> Any:
    """Open a file as a user would; return its armature."""
    before = set(bpy.data.objects)
    if path.endswith(".bvh"):
        bpy.ops.import_anim.bvh(filepath=path, update_scene_fps=True, update_scene_duration=True, **options)
    elif path.endswith(".fbx"):
        family, _dot, own = options.get("importer", "import_scene.fbx").partition(".")
        getattr(getattr(bpy.ops, family), own)(filepath=path)
    elif path.endswith(".usdc"):
        bpy.ops.wm.usd_import(filepath=path, **options)
    else:
        bpy.ops.import_scene.gltf(filepath=path, **options)
    return next(one for one in bpy.data.objects if one not in before and one.type == "ARMATURE")


def area_m2(body: Any) -> float:
    """Area of a body as it is drawn in the frame."""
    mesh = body.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    return sum(face.area for face in mesh.polygons)


def focal_px(camera: Any, width: int, height: int, pixel_height: float) -> list[float]:
    """Focal lengths of a camera in pixels across and upright, in pictures of a size."""
    size = {"x": width, "y": height, "scale_x": 1.0, "scale_y": pixel_height}
    projection = camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), **size)
    return [projection[0][0] * width / 2, projection[1][1] * height / 2]


def read(file: Mapping[str, Any]) -> dict[str, Any]:
    """Positions of the heads of bones, in the rest pose and in every frame, and areas of bodies in every frame."""
    scene = empty(file["frame_rate_hz"])
    armature = load(file["path"], file["import"])
    action = armature.animation_data.action
    first, last = action.frame_range
    # The add-on that imports FBX counts in whole frames a second: at 29.97 Hz a key lies at each 29.97th of a 30th.
    is_by_addon = file["path"].endswith(".fbx") and "importer" not in file["import"]
    step = scene.render.fps_base if is_by_addon else 1.0
    num_frames = round((last - first) / step) + 1
    times = [number + 0.5 for number in range(num_frames - 1)] if file["half_way"] else range(num_frames)
    frames = [first + time * step for time in times]
    rest = {bone.name: list(armature.matrix_world @ bone.head_local) for bone in armature.data.bones}
    armatures = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    is_usd = file["path"].endswith(".usdc")
    # Skeletons of USD files are below the objects of their people.
    names = {skeleton: skeleton.parent.name if is_usd else skeleton.name for skeleton in armatures}
    people: dict[str, dict[str, list[list[float]]]] = {
        names[skeleton]: {bone.name: [] for bone in skeleton.pose.bones} for skeleton in armatures
    }
    bodies = [body for body in armature.children if body.type == "MESH"]
    areas_m2 = []
    for frame in frames:
        scene.frame_set(math.floor(frame), subframe=frame - math.floor(frame))
        areas_m2.append([area_m2(body) for body in bodies])
        for skeleton in armatures:
            for bone in skeleton.pose.bones:
                people[names[skeleton]][bone.name].append(list(skeleton.matrix_world @ bone.head))
    cameras = {
        thing.name: {
            "focal_px": focal_px(thing, *file["pictures"][thing.name]),
            "matrix": [list(row) for row in thing.matrix_world],
        }
        for thing in bpy.data.objects
        if thing.type == "CAMERA"
    }
    floor = bpy.data.objects.get("floor")
    return {
        "people": people,
        "cameras": cameras,
        "floor": floor and [list(floor.matrix_world @ vertex.co) for vertex in floor.data.vertices],
        "frame_rate_hz": scene.render.fps / scene.render.fps_base,
        "rest": rest,
        "positions": people[names[armature]],
        "areas_m2": areas_m2,
    }


def material(name: str, rgb: tuple[float, float, float], roughness: float) -> Any:
    """Material of an object in the picture."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    surface = made.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (*rgb, 1.0)
    surface.inputs["Roughness"].default_value = roughness
    return made


def render(files: Sequence[Mapping[str, Any]], path: str) -> None:
    """Render all people on a floor, from the side."""
    scene = empty(files[0]["frame_rate_hz"])
    armatures = [load(file["path"], file["import"]) for file in files]
    first, last = armatures[0].animation_data.action.frame_range
    scene.frame_set(round(first + 0.42 * (last - first)))
    middles = [armature.matrix_world @ armature.pose.bones[0].head for armature in armatures]
    middle = sum(middles, Vector()) / len(middles)

    bpy.ops.mesh.primitive_plane_add(size=60.0)
    bpy.context.object.data.materials.append(material("floor", (0.8, 0.8, 0.8), 0.9))
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=60, y_subdivisions=60, size=60.0, location=(0.0, 0.0, 0.002))
    bpy.context.object.modifiers.new("lines", "WIREFRAME").thickness = 0.012
    bpy.context.object.data.materials.append(material("lines", (0.5, 0.55, 0.6), 0.9))
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 2.2, (0.7, 0.3, 0.4)
    scene.collection.objects.link(sun)
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.75, 0.85, 1.0, 1.0)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.6
    scene.view_settings.view_transform = "Standard"

    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    target = Vector((middle.x, middle.y, 0.9))
    reach = max(1.0, max((one - middle).length for one in middles) / 1.6)
    camera.location = target + Vector((ASIDE_M, -BACK_M * reach, ABOVE_M))
    camera.rotation_euler = (target - camera.location).to_track_quat("-Z", "Y").to_euler()
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 48, True
    scene.cycles.seed = 0
    scene.render.resolution_x, scene.render.resolution_y = 960, 540
    scene.render.image_settings.file_format, scene.render.image_settings.quality = "JPEG", 85
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)


job = json.loads(Path(sys.argv[1]).read_text())
found = {file["path"]: read(file) for file in job["files"]}
Path(job["out"]).write_text(json.dumps(found))
if job["picture"]:
    render([file for file in job["files"] if file["path"].endswith(".glb")], job["picture"])
