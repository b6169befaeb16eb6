"""Extension for Blender: its sources (``extension``) and the build of its zip (``build``)."""
