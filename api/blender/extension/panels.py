"""Panel in the sidebar of the 3D view."""

import textwrap
from typing import Any

import bpy

from api.blender.extension.characters import find_armature
from api.blender.extension.receiver import live
from api.blender.extension.work import current, extension_preferences, panel_state


class MULTICAP_UL_items(bpy.types.UIList):  # noqa: N801 - Blender asks for this form of names
    """Captures and jobs; people, each with a box to tick; joints with their bones."""

    def draw_item(self, _context: Any, layout: Any, data: Any, item: Any, _icon: Any, _active: Any, _name: Any) -> None:
        if item.joint:
            row = layout.split(factor=0.45)
            row.label(text=item.joint)
            if (armature := find_armature(data.armature)) is not None:
                row.prop_search(item, "bone", armature.data, "bones", text="")
        elif item.is_person:
            layout.prop(item, "is_chosen", text=item.label)
        else:
            layout.label(text=item.label)


class _Panel(bpy.types.Panel):
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Multicap"


class MULTICAP_PT_service(_Panel):  # noqa: N801 - likewise
    """Service: connection, what runs, messages."""

    bl_label = "Multicap"

    def draw(self, context: Any) -> None:
        state, preferences, layout = panel_state(context), extension_preferences(context), self.layout
        layout.prop(preferences, "address", text="")
        layout.prop(preferences, "key", text="Key")
        row = layout.row(align=True)
        row.operator("multicap.connect", text="Connect again" if state.is_connected else "Connect", icon="LINKED")
        row.operator("multicap.open_page", text="", icon="URL")
        if current.is_busy:
            layout.label(text=state.doing)
            row = layout.row(align=True)
            row.progress(factor=max(state.fraction, 0.0), text=f"{max(state.fraction, 0.0):.0%}")
            row.operator("multicap.stop", text="", icon="CANCEL")
        width = max(20, int(context.region.width / (8 * context.preferences.system.ui_scale)) if context.region else 40)
        for number, line in enumerate(textwrap.wrap(state.message, width, break_long_words=False)):
            layout.label(text=line, icon="NONE" if number else "ERROR" if state.is_error else "INFO")


class MULTICAP_PT_captures(_Panel):  # noqa: N801 - likewise
    """Captures, their jobs, and the people of a job."""

    bl_label, bl_parent_id = "Captures", "MULTICAP_PT_service"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return bool(panel_state(context).is_connected)

    def draw(self, context: Any) -> None:
        state, layout = panel_state(context), self.layout
        row = layout.row(align=True)
        row.prop(state, "search", text="", icon="VIEWZOOM")
        row.operator("multicap.refresh", text="", icon="FILE_REFRESH")
        layout.template_list("MULTICAP_UL_items", "captures", state, "captures", state, "capture", rows=4)
        if state.cursor:
            layout.operator("multicap.refresh", text="More").is_next = True
        layout.operator("multicap.jobs")
        if state.jobs:
            layout.template_list("MULTICAP_UL_items", "jobs", state, "jobs", state, "job", rows=2)
            row = layout.row(align=True)
            row.operator("multicap.people")
            row.operator("multicap.cancel_job", text="", icon="X")
        if state.people:
            layout.template_list("MULTICAP_UL_items", "people", state, "people", state, "person", rows=3)
            layout.prop(state, "has_timeline")
            layout.prop(state, "has_cameras")
            layout.operator("multicap.import_people", icon="IMPORT")


class MULTICAP_PT_character(_Panel):  # noqa: N801 - likewise
    """Motion on an armature of the scene."""

    bl_label, bl_parent_id, bl_options = "On an armature", "MULTICAP_PT_service", {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return bool(panel_state(context).is_connected)

    def draw(self, context: Any) -> None:
        state, layout = panel_state(context), self.layout
        _draw_armature(state, layout)
        if find_armature(state.armature) is not None:
            layout.operator("multicap.put_on", icon="ARMATURE_DATA")


class MULTICAP_PT_live(_Panel):  # noqa: N801 - likewise
    """Armatures of the scene that move as the people of a live capture."""

    bl_label, bl_parent_id, bl_options = "Live", "MULTICAP_PT_service", {"DEFAULT_CLOSED"}

    def draw(self, context: Any) -> None:
        state, layout = panel_state(context), self.layout
        if state.is_receiving:
            layout.prop(state, "take")
            layout.operator("multicap.record", text="End take" if live.take else "Record take", icon="REC")
            layout.operator("multicap.receive", text="Stop receiving", icon="PAUSE")
            return
        for name in ("live_port", "live_people", *(f"live_{number + 1}" for number in range(state.live_people))):
            layout.prop(state, name)
        layout.operator("multicap.receive", icon="PLAY")
        layout.label(text="Bones of an armature:")
        _draw_armature(state, layout)


class MULTICAP_PT_send(_Panel):  # noqa: N801 - likewise
    """New capture from a folder."""

    bl_label, bl_parent_id, bl_options = "New capture", "MULTICAP_PT_service", {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        state = panel_state(context)
        return bool(state.is_connected and state.may_write)

    def draw(self, context: Any) -> None:
        state, layout = panel_state(context), self.layout
        for name in ("folder", "calibration", "name", "has_human"):
            layout.prop(state, name)
        layout.operator("multicap.send", icon="EXPORT")


def _draw_armature(state: Any, layout: Any) -> None:
    layout.prop(state, "armature")
    if find_armature(state.armature) is not None:
        layout.template_list("MULTICAP_UL_items", "bones", state, "bones", state, "bone", rows=6)
        row = layout.row(align=True)
        row.operator("multicap.recognise")
        if state.may_write:
            row.operator("multicap.ask_for_bones")


PANELS = (
    MULTICAP_UL_items,
    MULTICAP_PT_service,
    MULTICAP_PT_captures,
    MULTICAP_PT_character,
    MULTICAP_PT_live,
    MULTICAP_PT_send,
)
"""Classes to register."""
