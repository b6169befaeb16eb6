"""Classes of the extension in Blender."""

import bpy

from api.blender.extension import work
from api.blender.extension.operators import OPERATORS
from api.blender.extension.panels import PANELS
from api.blender.extension.properties import PROPERTIES, MulticapState
from api.blender.extension.receiver import live

_CLASSES = (*PROPERTIES, *OPERATORS, *PANELS)


def register() -> None:
    """Add the classes to Blender."""
    for kind in _CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.WindowManager.multicap = bpy.props.PointerProperty(type=MulticapState)


def unregister() -> None:
    """Stop what runs, and remove the classes from Blender."""
    live.stop()
    work.end()
    del bpy.types.WindowManager.multicap
    for kind in reversed(_CLASSES):
        bpy.utils.unregister_class(kind)
