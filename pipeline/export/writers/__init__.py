"""Formats of result files: each module encodes a motion or tracks, and reads the positions back."""
