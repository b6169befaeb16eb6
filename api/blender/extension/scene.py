"""People and cameras of a take in the scene of Blender."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from inspect import getsource
from pathlib import Path
from typing import Any

import bpy

from api.blender.extension.answers import RequestError
from api.blender.extension.glb_motion import GlbFacts


@contextmanager
def object_mode() -> Iterator[None]:
    """Leave edit and pose mode for an import; timers of Blender have no window, importers need one."""
    windows = bpy.context.window_manager.windows
    with bpy.context.temp_override(**({"window": windows[0]} if len(windows) and not bpy.context.window else {})):
        if bpy.context.object is not None and bpy.context.object.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        yield


def set_timeline(scene: Any, facts: GlbFacts) -> None:
    """Give a scene the frame rate and the frames of a take: frame 0 is the first one."""
    whole = max(1, round(facts.frame_rate_hz))
    scene.render.fps = whole
    scene.render.fps_base = whole / facts.frame_rate_hz
    scene.frame_start, scene.frame_end = 0, max(0, facts.num_frames - 1)
    scene.frame_set(0)


def scene_rate_hz(scene: Any) -> float:
    """Frames a second of a scene."""
    return float(scene.render.fps) / float(scene.render.fps_base)


def import_person(path: Path, name: str, collection: Any) -> Any:
    """Import the person of a GLB or FBX file into a collection; return the armature, which gets the name.

    Raises ``RequestError`` if the importer of Blender refuses the file, or finds no person in it.
    """
    added = _imported(path)
    armatures = [thing for thing in added if thing.type == "ARMATURE"]
    if len(armatures) != 1:
        _remove(added)
        raise RequestError(f"The file of {name} has {len(armatures)} skeletons. It should have one.")
    _move(_without_helpers(added), collection)
    (armature,) = armatures
    armature.name, armature.data.name = name, name
    for thing in armature.children_recursive:
        thing.name = f"{name} body"
    if armature.animation_data is not None and armature.animation_data.action is not None:
        armature.animation_data.action.name = name
    return armature


def import_cameras(path: Path, collection: Any) -> list[Any]:
    """Import the cameras of a take, and the floor, from its GLB file; people in it are left out."""
    added = _imported(path)
    kept = [
        thing for thing in added if thing.type == "CAMERA" or (thing.type == "MESH" and thing.name.startswith("floor"))
    ]
    _remove([thing for thing in added if thing not in kept])
    _move(kept, collection)
    return [thing for thing in kept if thing.type == "CAMERA"]


def add_collection(scene: Any, name: str) -> Any:
    """New collection of a take in a scene."""
    collection = bpy.data.collections.new(name)
    scene.collection.children.link(collection)
    return collection


@contextmanager
def _importer_base(render: Any) -> Iterator[None]:
    """Have the importer of glTF place keys at the scene's frame rate.

    Blender 4.2 to 5.2 multiplies seconds by ``fps * fps_base``; the frame rate is their quotient.
    """
    base = render.fps_base
    importer = import_module("io_scene_gltf2.blender.imp.animation_node")
    if "fps * bpy.context.scene.render.fps_base" in getsource(importer):
        render.fps_base = 1.0 / base
    try:
        yield
    finally:
        render.fps_base = base


def _imported(path: Path) -> list[Any]:
    before = set(bpy.data.objects)
    actions = set(bpy.data.actions)
    try:
        with object_mode():
            if path.suffix == ".fbx" and "fbx_import" in dir(bpy.ops.wm):
                bpy.ops.wm.fbx_import(filepath=str(path))
            elif path.suffix == ".fbx":  # Before Blender 4.5; keys lie at whole frames a second.
                bpy.ops.import_scene.fbx(filepath=str(path), use_image_search=False)
            else:
                with _importer_base(bpy.context.scene.render):
                    bpy.ops.import_scene.gltf(filepath=str(path), bone_heuristic="TEMPERANCE")
    except RuntimeError as error:
        _remove([thing for thing in bpy.data.objects if thing not in before])
        for action in set(bpy.data.actions) - actions:
            bpy.data.actions.remove(action)
        raise RequestError("Blender can't open the file of the service.") from error
    except AttributeError as error:
        raise RequestError("Blender's importer of this format is switched off: see Preferences, Add-ons.") from error
    return [thing for thing in bpy.data.objects if thing not in before]


def _without_helpers(things: Sequence[Any]) -> list[Any]:
    """Objects without the shapes that the importer of glTF draws bones as."""
    shapes = {bone.custom_shape for thing in things if thing.type == "ARMATURE" for bone in thing.pose.bones}
    for thing in things:
        if thing.type == "ARMATURE":
            for bone in thing.pose.bones:
                bone.custom_shape = None
    kept = [thing for thing in things if thing not in shapes]
    _remove([thing for thing in things if thing in shapes])
    return kept


def _move(things: Sequence[Any], collection: Any) -> None:
    for thing in things:
        for holder in list(thing.users_collection):
            holder.objects.unlink(thing)
        collection.objects.link(thing)
    # The importer of glTF leaves the empty collection of its shapes.
    for holder in [holder for holder in bpy.data.collections if holder.name.startswith("glTF_not_exported")]:
        if not holder.objects and not holder.children:
            bpy.data.collections.remove(holder)


def _remove(things: Sequence[Any]) -> None:
    """Remove objects with their data and their actions, unless others use them."""
    shapes = [thing.data.shape_keys for thing in things if thing.type == "MESH"]
    moving = [owner.animation_data for owner in (*things, *shapes) if owner is not None]
    actions = {data.action for data in moving if data is not None and data.action is not None}
    holders: Mapping[str, Any] = {"ARMATURE": bpy.data.armatures, "MESH": bpy.data.meshes}
    blocks = {(thing.type, thing.data) for thing in things if thing.type in holders}
    for thing in things:
        bpy.data.objects.remove(thing)
    for kind, block in blocks:
        if not block.users:
            holders[kind].remove(block)
    for action in actions:
        if not action.users:
            bpy.data.actions.remove(action)
