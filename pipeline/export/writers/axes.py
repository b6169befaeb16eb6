"""Axes of files."""

import numpy as np

WORLD = np.eye(3)
"""World axes: Z up, facing -Y in the rest pose."""

Y_UP_FROM_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Axes with Y up: x, y, z are the world's x, z, -y, and the rest pose faces +Z."""
