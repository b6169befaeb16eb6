"""Cameras, lenses, rays, epipolar lines, triangulation; the compiled loops. Imports ``core``."""
