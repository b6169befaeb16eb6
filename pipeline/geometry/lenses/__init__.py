"""Distortion models beside the standard one, which is in ``geometry/camera.py``."""
