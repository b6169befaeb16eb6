"""Preferences, and lists and choices of the panel, as properties of Blender."""

from typing import Any

import bpy

from api.blender.extension.characters import recognise


class MulticapCapture(bpy.types.PropertyGroup):
    """Capture in the list."""

    ident: bpy.props.StringProperty()
    label: bpy.props.StringProperty()


class MulticapJob(bpy.types.PropertyGroup):
    """Job of the chosen capture."""

    ident: bpy.props.StringProperty()
    label: bpy.props.StringProperty()
    is_ready: bpy.props.BoolProperty()


class MulticapPerson(bpy.types.PropertyGroup):
    """Person of the chosen job."""

    label: bpy.props.StringProperty()
    number: bpy.props.IntProperty()  # Place of the file among the job's files
    is_chosen: bpy.props.BoolProperty(name="Import", default=True)


class MulticapBone(bpy.types.PropertyGroup):
    """Bone of the chosen armature that follows a joint."""

    joint: bpy.props.StringProperty()
    bone: bpy.props.StringProperty(name="Bone")


def _of_capture(state: Any, _context: Any) -> None:
    """Forget the jobs and the people of the capture that was chosen before."""
    state.jobs.clear()
    state.people.clear()


def _of_job(state: Any, _context: Any) -> None:
    state.people.clear()


def _of_armature(state: Any, _context: Any) -> None:
    """Recognise the bones of an armature as soon as it is chosen."""
    state.bones.clear()
    if state.armature is not None:
        recognise(state)


def _is_armature(panel_state: Any, thing: Any) -> bool:
    return bool(thing.type == "ARMATURE")


class MulticapState(bpy.types.PropertyGroup):
    """Panel's lists and choices; they last as long as Blender runs."""

    tenant: bpy.props.StringProperty()
    is_connected: bpy.props.BoolProperty()
    may_write: bpy.props.BoolProperty()
    message: bpy.props.StringProperty()
    is_error: bpy.props.BoolProperty()
    doing: bpy.props.StringProperty()
    fraction: bpy.props.FloatProperty(default=-1.0)
    search: bpy.props.StringProperty(name="Search", description="Only captures whose names contain this text")
    captures: bpy.props.CollectionProperty(type=MulticapCapture)
    capture: bpy.props.IntProperty(update=_of_capture)
    cursor: bpy.props.StringProperty()
    jobs: bpy.props.CollectionProperty(type=MulticapJob)
    job: bpy.props.IntProperty(update=_of_job)
    people: bpy.props.CollectionProperty(type=MulticapPerson)
    person: bpy.props.IntProperty()
    has_timeline: bpy.props.BoolProperty(
        name="Timeline of the take",
        description="Give the scene the frame rate and the frames of the take; else keys keep their times",
        default=True,
    )
    has_cameras: bpy.props.BoolProperty(
        name="Cameras and floor", description="Import the cameras of the capture, and its floor", default=False
    )
    armature: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Armature", poll=_is_armature, update=_of_armature,
        description="Armature of the scene that gets the motion of the first chosen person",
    )  # fmt: skip
    bones: bpy.props.CollectionProperty(type=MulticapBone)
    bone: bpy.props.IntProperty()
    live_port: bpy.props.IntProperty(
        name="Port", description="Port of this machine to which the person is sent: --output vmc://HOST:PORT",
        default=39539, min=1, max=65535,
    )  # fmt: skip
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
    MulticapCapture,
    MulticapJob,
    MulticapPerson,
    MulticapBone,
    MulticapState,
    MulticapPreferences,
)
"""Classes to register, in this order."""
