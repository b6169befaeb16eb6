"""Program for Blender's Python: installs the extension from its zip, and does what a user would.

    python program.py JOB.json

``JOB.json`` is ``{"zip", "address", "key", "steps", "out"}``; a step is a name and its arguments. What each step
found is written to ``out``.
"""

import contextlib
import json
import math
import socket
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from mathutils import Matrix, Vector

NAME = "bl_ext.user_default.multicap"


def install(path: str) -> Any:
    """Install the extension; return its module ``work``."""
    bpy.ops.extensions.package_install_files(filepath=path, repo="user_default", enable_on_install=True)
    return sys.modules[f"{NAME}.work"]


class RecordedLayout:
    """Layout that takes note of what is shown, and fails for operators and properties that are not there."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def row(self, **_: Any) -> "RecordedLayout":
        return self

    def label(self, *, text: str, **_: Any) -> None:
        self.shown.append(text)

    def progress(self, *, text: str, **_: Any) -> None:
        self.shown.append(text)

    def prop(self, data: Any, name: str, **_: Any) -> None:
        self.shown.append(data.bl_rna.properties[name].name)

    def operator(self, name: str, **_: Any) -> Any:
        family, _dot, own = name.partition(".")
        self.shown.append(getattr(getattr(bpy.ops, family), own).get_rna_type().name)
        return types.SimpleNamespace()

    def template_list(self, kind: str, _id: str, data: Any, items: str, active: Any, index: str, **_: Any) -> None:
        # An index is a number of its own for each list.
        assert hasattr(bpy.types, kind)
        assert active.bl_rna.properties[index].type == "INT"
        assert index == {"captures": "capture", "jobs": "job", "people": "person", "bones": "bone"}[items]
        self.shown.append(f"{len(getattr(data, items))} {items}")


class PanelUser:
    """User of the panel."""

    def __init__(self, job: dict[str, Any]) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._work = install(job["zip"])
        preferences = bpy.context.preferences.addons[NAME].preferences
        preferences.address, preferences.key = job["address"], job["key"]

    @property
    def panel(self) -> Any:
        return bpy.context.window_manager.multicap

    def press(self, name: str, *, seconds: float = 60.0, **options: Any) -> dict[str, Any]:
        """Press a button, and wait until nothing runs."""
        with contextlib.suppress(RuntimeError):  # The panel says what is wrong.
            getattr(bpy.ops.multicap, name)(**options)
        longest_s, end_s = 0.0, time.monotonic() + seconds
        while True:
            start_s = time.monotonic()
            is_busy = self._work.pump()
            longest_s = max(longest_s, time.monotonic() - start_s)
            if not is_busy or time.monotonic() > end_s:
                break
            time.sleep(0.01)
        return {
            "message": self.panel.message,
            "is_error": self.panel.is_error,
            "is_busy": is_busy,
            "longest_s": longest_s,
        }

    def show_people(self) -> dict[str, Any]:
        """Connect, and go to the people of the newest job of the newest capture."""
        said = [self.press(name)["message"] for name in ("connect", "jobs", "people")]
        panel = self.panel
        return {
            "messages": said,
            "captures": [item.label for item in panel.captures],
            "jobs": [item.label for item in panel.jobs],
            "people": [item.label for item in panel.people],
            "tenant": panel.tenant,
        }

    def set_panel(self, **values: Any) -> None:
        for name, value in values.items():
            setattr(self.panel, name, value)

    def choose(self, people: list[int]) -> None:
        for number, person in enumerate(self.panel.people):
            person.is_chosen = number in people

    def choose_armature(self, name: str) -> None:
        self.panel.armature = name

    def open_armature(self, path: str) -> None:
        """Import a character of the user's own, and choose it."""
        before = set(bpy.data.objects)
        bpy.ops.import_scene.gltf(filepath=path)
        self.panel.armature = self.panel.live_1 = next(
            added.name for added in bpy.data.objects if added not in before and added.type == "ARMATURE"
        )

    def bones(self) -> dict[str, str]:
        return {item.joint: item.bone for item in self.panel.bones}

    def set_rate(self, fps: int, fps_base: float) -> None:
        bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = fps, fps_base

    def keys(self) -> dict[str, list[float]]:
        """First and last frame with a key of each action, and frames a second of the scene."""
        render = bpy.context.scene.render
        spans = {action.name: list(action.curve_frame_range) for action in bpy.data.actions}
        return {**spans, "rate": [render.fps, render.fps_base]}

    def scene(self) -> dict[str, Any]:
        """Content of the scene, with the world positions of bones in each frame."""
        scene = bpy.context.scene
        armatures = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
        heads: dict[str, dict[str, list[list[float]]]] = {
            thing.name: {bone.name: [] for bone in thing.pose.bones} for thing in armatures
        }
        for frame in range(scene.frame_start, scene.frame_end + 1):
            scene.frame_set(frame)
            for thing in armatures:
                for bone in thing.pose.bones:
                    heads[thing.name][bone.name].append(list(thing.matrix_world @ bone.head))
        return {
            "rate_hz": scene.render.fps / scene.render.fps_base,
            "frames": [scene.frame_start, scene.frame_end],
            "objects": {thing.name: thing.type for thing in bpy.data.objects},
            "actions": sorted(action.name for action in bpy.data.actions),
            "collections": [collection.name for collection in scene.collection.children],
            "heads": heads,
            "rest": {
                thing.name: {bone.name: list(thing.matrix_world @ bone.head_local) for bone in thing.data.bones}
                for thing in armatures
            },
        }

    def stop_sending(self) -> dict[str, Any]:
        """Begin to send, stop after the first progress; return how long the button took."""
        bpy.ops.multicap.send()
        while self.panel.fraction <= 0.0:
            self._work.pump()
            time.sleep(0.005)
        start_s = time.monotonic()
        bpy.ops.multicap.stop()
        took_s = time.monotonic() - start_s
        self._work.pump()
        return {"message": self.panel.message, "took_s": took_s}

    def follow(self, seconds: float) -> dict[str, Any]:
        """Follow the chosen job for some time; return what the panel said, and the longest time that it took."""
        bpy.ops.multicap.people()
        texts: list[str] = []
        longest_s, end_s = 0.0, time.monotonic() + seconds
        while time.monotonic() < end_s and not (texts and "tried again" in texts[-1]):
            start_s = time.monotonic()
            self._work.pump()
            longest_s = max(longest_s, time.monotonic() - start_s)
            if self.panel.doing not in texts[-1:]:
                texts.append(self.panel.doing)
                print("followed" if "queued" in self.panel.doing else "begun")  # noqa: T201 - the test waits for it
            time.sleep(0.02)
        return {"texts": texts, "longest_s": longest_s}

    def draw(self) -> dict[str, list[str]]:
        """Draw the panels into a layout that checks operators and properties; return what they show."""
        panels = sys.modules[f"{NAME}.panels"]
        shown = {}
        for panel in panels.PANELS:
            if issubclass(panel, bpy.types.Panel) and (not hasattr(panel, "poll") or panel.poll(bpy.context)):
                layout = RecordedLayout()
                panel.draw(types.SimpleNamespace(layout=layout), bpy.context)
                shown[panel.__name__] = layout.shown
        return shown

    def receive(self, seconds: float) -> dict[str, Any]:
        """Receive live people until armatures move; return what the panel said, and where bones are."""
        live = sys.modules[f"{NAME}.receiver"].live
        with contextlib.suppress(RuntimeError):  # The panel says what is wrong.
            bpy.ops.multicap.receive()
        said, drawn = [self.panel.message], self.draw()["MULTICAP_PT_live"]
        print("listening")  # noqa: T201 - the test waits for it
        end_s, num_left = time.monotonic() + seconds, 20
        while self.panel.is_receiving and num_left and time.monotonic() < end_s:
            live.step()
            num_left -= "move" in self.panel.message
            time.sleep(0.01)
        said.append(self.panel.message)
        armature = bpy.data.objects[self.panel.live_1]
        actions, heads = self._actions(armature), self.heads(armature)
        if self.panel.is_receiving:
            bpy.ops.multicap.receive()
        return {"said": said, "drawn": drawn, "heads": heads, "actions": actions, "after": self._actions(armature)}

    def heads(self, armature: Any) -> dict[str, list[float]]:
        bpy.context.view_layer.update()
        return {bone.name: list(armature.matrix_world @ bone.head) for bone in armature.pose.bones}

    def _actions(self, armature: Any) -> list[str]:
        return [data.action.name for data in (armature.animation_data,) if data is not None and data.action]

    def record(self, num_people: int, seconds: float, middle: str = "", ends: str = "record") -> dict[str, Any]:
        """Receive people and record a take of them; return the message, and poses of the actions at their frames.

        ``middle``: what happens in the middle of the take, ``undo`` or an armature that is removed. ``ends``: button
        that ends the take, or several that are pressed at once.
        """
        live = sys.modules[f"{NAME}.receiver"].live
        self.panel.live_people = num_people
        for name in ("original", "begin"):
            bpy.ops.ed.undo_push(message=name)
        bpy.ops.multicap.receive()
        print("listening")  # noqa: T201 - the test waits for it
        self._step(live, 30.0, lambda: all(getattr(self.panel, f"live_{n + 1}") for n in range(num_people)))
        bpy.ops.multicap.record()
        drawn = self.draw()["MULTICAP_PT_live"]
        self._step(live, seconds / 2)
        if middle == "undo":
            bpy.ops.ed.undo()
            assert "Person 1" not in bpy.data.objects
        elif middle:
            bpy.data.objects.remove(bpy.data.objects[middle])
        self._step(live, seconds / 2)
        *first, last = ends.split()
        for button in first:
            getattr(bpy.ops.multicap, button)()
        ended = self.press(last)
        if self.panel.is_receiving:
            bpy.ops.multicap.receive()
        scene, poses = bpy.context.scene, {}
        armatures = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
        for frame in range(scene.frame_start, scene.frame_end + 1):
            scene.frame_set(frame)
            poses[frame] = {thing.name: self.heads(thing) for thing in armatures}
        actions = {action.name: list(action.curve_frame_range) for action in bpy.data.actions}
        own = {thing.name: self._actions(thing) for thing in armatures}
        return {"ended": ended, "drawn": drawn, "poses": poses, "actions": actions, "own": own}

    def undo(self) -> dict[str, list[str]]:
        """Undo the last step, and do it again; return the actions before, in between and behind."""
        actions = {"before": [action.name for action in bpy.data.actions]}
        for name in ("undo", "redo"):
            getattr(bpy.ops.ed, name)()
            actions[name] = [action.name for action in bpy.data.actions]
        return actions

    def _step(self, live: Any, seconds: float, is_over: Callable[[], bool] = lambda: False) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and not is_over():
            live.step()
            time.sleep(0.01)

    def choose_live(self, person: int) -> None:
        """Choose the character for a person of the live capture."""
        self.panel.live_1 = ""
        setattr(self.panel, f"live_{person}", self.panel.armature)

    def take_port(self, port: int) -> None:
        """Be another program that has the port."""
        self._other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._other.bind(("127.0.0.1", port))

    def move_armature(self, place: list[float], degrees: float, size: float) -> None:
        armature = bpy.data.objects[self.panel.armature]
        while armature.parent is not None:
            armature = armature.parent
        armature.location, armature.scale = place, armature.scale * size
        armature.rotation_mode = "XYZ"
        armature.rotation_euler = (*armature.rotation_euler[:2], math.radians(degrees))
        bpy.context.view_layer.update()

    def render(self, path: str) -> None:
        """Render the scene, from the front and a little above, at a frame in the middle."""
        scene = bpy.context.scene
        scene.frame_set((scene.frame_start + scene.frame_end) // 2)
        roots = [
            thing.matrix_world @ thing.pose.bones[0].head for thing in bpy.data.objects if thing.type == "ARMATURE"
        ]
        middle = sum(roots, Vector()) / len(roots)
        middle.z = 0.85
        reach_m = max(1.5, *((root - middle).to_2d().length for root in roots))
        material = bpy.data.materials.new("ground")
        material.use_nodes = True
        surface = material.node_tree.nodes["Principled BSDF"].inputs
        surface["Base Color"].default_value, surface["Roughness"].default_value = (0.2, 0.22, 0.25, 1.0), 0.9
        bpy.ops.mesh.primitive_plane_add(size=60.0, location=(0.0, 0.0, -0.005))
        bpy.context.object.data.materials.append(material)
        for thing in bpy.data.objects:
            if thing.type == "CAMERA":
                self._draw_camera(thing, scene)
        scene.camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
        scene.collection.objects.link(scene.camera)
        scene.camera.location = middle + Vector((1.0, -2.7, 0.9)) * reach_m
        scene.camera.rotation_euler = (middle - scene.camera.location).to_track_quat("-Z", "Y").to_euler()
        sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
        sun.data.energy, sun.data.angle, sun.rotation_euler = 2.2, 0.15, (0.7, 0.25, 0.5)
        scene.collection.objects.link(sun)
        scene.world = bpy.data.worlds.new("sky")
        scene.world.use_nodes = True
        scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.72, 0.8, 0.92, 1.0)
        scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.35
        scene.view_settings.view_transform = "Standard"
        scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 40
        scene.cycles.use_denoising, scene.cycles.seed = True, 0
        scene.render.resolution_x, scene.render.resolution_y = 800, 450
        scene.render.image_settings.file_format, scene.render.image_settings.quality = "JPEG", 82
        scene.render.filepath = path
        bpy.ops.render.render(write_still=True)

    def _draw_camera(self, camera: Any, scene: Any) -> None:
        """Draw a camera, which a picture does not show, as a pyramid."""
        width, height = math.tan(camera.data.angle_x / 2), math.tan(camera.data.angle_y / 2)
        corners = [(x * width, y * height, -1.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        mesh = bpy.data.meshes.new("pyramid")
        sides = [(0, 1 + number, 1 + (number + 1) % 4) for number in range(4)]
        mesh.from_pydata([(0.0, 0.0, 0.0), *corners], [], sides)
        pyramid = bpy.data.objects.new("pyramid", mesh)
        pyramid.modifiers.new("edges", "WIREFRAME").thickness = 0.06
        pyramid.matrix_world = camera.matrix_world @ Matrix.Scale(0.4, 4)
        scene.collection.objects.link(pyramid)

    def unregister(self) -> list[str]:
        """Switch the extension off; return what it left in Blender."""
        bpy.ops.preferences.addon_disable(module=NAME)
        return [name for name in dir(bpy.types) if name.lower().startswith("multicap")]


job = json.loads(Path(sys.argv[1]).read_text())
user = PanelUser(job)
found = []
for name, options in job["steps"]:
    step: Callable[..., Any] = getattr(user, name)
    found.append(step(**options))
Path(job["out"]).write_text(json.dumps(found))
