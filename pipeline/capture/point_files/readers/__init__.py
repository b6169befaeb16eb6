"""Readers of 3D points, a module a format."""
