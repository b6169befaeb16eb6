"""Corners of a board in a picture."""
