"""Preferences, and lists and choices of the panel, as properties of Blender."""

from typing import Any

import bpy

from api.blender.extension.characters import find_armature, known_bones, show_bones, stated_bones
from api.blender.extension.work import panel_state

MAX_LIVE = 8
"""Largest number of people of a live capture."""


def _of_bone(_bone: Any, context: Any) -> None:
    """Know the bones of the armature from now on."""
    stated_bones(panel_state(context))


class MulticapItem(bpy.types.PropertyGroup):
    """Capture, job, person or joint in a list."""

    ident: bpy.props.StringProperty()
    label: bpy.props.StringProperty()
    is_person: bpy.props.BoolProperty()
    number: bpy.props.IntProperty()  # Place of a person's file among the job's files
    is_chosen: bpy.props.BoolProperty(name="Import", default=True)
    joint: bpy.props.StringProperty()
    bone: bpy.props.StringProperty(name="Bone", update=_of_bone)  # Bone of the chosen armature that follows the joint


def _of_capture(state: Any, _context: Any) -> None:
    """Forget the jobs and the people of the capture that was chosen before."""
    state.jobs.clear()
    state.people.clear()


def _of_job(state: Any, _context: Any) -> None:
    state.people.clear()


def _of_armature(state: Any, _context: Any) -> None:
    """Show the bones of an armature as soon as it is chosen."""
    state.bones.clear()
    if (armature := find_armature(state.armature)) is not None:
        show_bones(state, known_bones(armature))


def _armatures(_state: Any, _context: Any, _text: str) -> list[str]:
    return [thing.name for thing in bpy.data.objects if thing.type == "ARMATURE"]


class MulticapState(bpy.types.PropertyGroup):
    """Panel's lists and choices; they last as long as Blender runs.

    Armatures are names: a pointer of the window manager to an object that is deleted stays, and ends Blender.
    """

    tenant: bpy.props.StringProperty()
    is_connected: bpy.props.BoolProperty()
    may_write: bpy.props.BoolProperty()
    message: bpy.props.StringProperty()
    is_error: bpy.props.BoolProperty()
    doing: bpy.props.StringProperty()
    fraction: bpy.props.FloatProperty(default=-1.0)
    search: bpy.props.StringProperty(name="Search", description="Only captures whose names contain this text")
    captures: bpy.props.CollectionProperty(type=MulticapItem)
    capture: bpy.props.IntProperty(update=_of_capture)
    cursor: bpy.props.StringProperty()
    jobs: bpy.props.CollectionProperty(type=MulticapItem)
    job: bpy.props.IntProperty(update=_of_job)
    people: bpy.props.CollectionProperty(type=MulticapItem)
    person: bpy.props.IntProperty()
    has_timeline: bpy.props.BoolProperty(
        name="Timeline of the take",
        description="Give the scene the frame rate and the frames of the take; else keys keep their times",
        default=True,
    )
    has_cameras: bpy.props.BoolProperty(
        name="Cameras and floor", description="Import the cameras of the capture, and its floor", default=False
    )
    armature: bpy.props.StringProperty(
        name="Armature", search=_armatures, update=_of_armature,
        description="Armature of the scene that gets the motion of the first chosen person",
    )  # fmt: skip
    bones: bpy.props.CollectionProperty(type=MulticapItem)
    bone: bpy.props.IntProperty()
    live_port: bpy.props.IntProperty(
        name="Port", description="Port of this machine to which person 1 is sent: --output vmc://HOST:PORT?people=N",
        default=39539, min=1, max=65535 - MAX_LIVE,
    )  # fmt: skip
    live_people: bpy.props.IntProperty(
        name="People", description="Number of people; each has a port, from the first one on", default=1, min=1,
        max=MAX_LIVE,
    )  # fmt: skip
    take: bpy.props.StringProperty(name="Take", description="Name of the takes; each gets a number", default="Take")
    is_receiving: bpy.props.BoolProperty()
    folder: bpy.props.StringProperty(
        name="Videos", subtype="DIR_PATH", description="Folder with a video of each camera"
    )
    calibration: bpy.props.StringProperty(
        name="Calibration", subtype="FILE_PATH", description="Calibration file; empty: the only one of the folder"
    )
    has_human: bpy.props.BoolProperty(
        name="Human bodies",
        description="Bodies of humans instead of capsules, if they are installed in the service",
        default=False,
    )
    name: bpy.props.StringProperty(name="Name", description="Name of the capture; empty: the folder's name")


MulticapState.__annotations__.update(
    {
        f"live_{number}": bpy.props.StringProperty(
            name=f"Person {number}", search=_armatures,
            description="Armature that moves as the person; empty: the extension makes a simple one",
        )
        for number in range(1, MAX_LIVE + 1)
    }
)  # fmt: skip


class MulticapPreferences(bpy.types.AddonPreferences):
    """Service and key."""

    bl_idname = __package__

    address: bpy.props.StringProperty(
        name="Service", default="http://127.0.0.1:8000", description="Address of the service, as in a browser"
    )
    key: bpy.props.StringProperty(
        name="API key", subtype="PASSWORD", description="Key, mc_..., of a service with keys; Blender stores it as text"
    )

    def draw(self, _context: Any) -> None:
        self.layout.prop(self, "address")
        self.layout.prop(self, "key")


PROPERTIES = (
    MulticapItem,
    MulticapState,
    MulticapPreferences,
)
"""Classes to register, in this order."""
