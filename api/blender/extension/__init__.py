"""Extension for Blender: captures of a Multicap service in the scene.

Modules without ``bpy``: ``client`` (the service), ``answers`` (its answers, checked), ``tasks`` (work in a thread),
``glb_motion`` (motion of a file), ``bone_tree`` and ``retarget`` (motion on other skeletons), ``capture_folder`` (files
to send), ``vmc_person`` (a person of a live capture), ``take`` (people over time). Modules of Blender: ``interface``
registers ``properties``, ``operators`` and ``panels``; ``work`` is what runs; ``scene`` (people and cameras),
``characters`` (armatures of the scene, their bones), ``receiver`` (armatures that move live).
"""


def register() -> None:
    """Add the extension to Blender."""
    from api.blender.extension import interface  # noqa: PLC0415 - Blender alone has bpy

    interface.register()


def unregister() -> None:
    """Remove the extension from Blender."""
    from api.blender.extension import interface  # noqa: PLC0415 - Blender alone has bpy

    interface.unregister()
