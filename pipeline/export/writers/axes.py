"""Axes that files have."""

import numpy as np

WORLD = np.eye(3)
"""The world's own: Z up, facing -Y in the rest pose."""

Y_UP_FROM_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""x, y, z with Y up are the world's x, z, -y; the rest pose faces +Z."""
