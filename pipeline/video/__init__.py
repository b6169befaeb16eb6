"""Videos, their sound and sequences of images: probed, decoded and written in child processes.

Imports ``geometry`` and ``core``.
"""
