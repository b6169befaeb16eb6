"""Axes that files have instead of the world's, which has Z up."""

import numpy as np

Y_UP_FROM_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""x, y, z with Y up are the world's x, z, -y."""
