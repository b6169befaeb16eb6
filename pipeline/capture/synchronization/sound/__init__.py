"""Offsets of cameras from the onsets of their sound, alone and together with motion."""
