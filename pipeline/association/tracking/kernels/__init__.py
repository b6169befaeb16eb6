"""Compiled loops of cross-view tracking, and the arrays of the tracker's state."""
