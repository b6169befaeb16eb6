"""Calibrations in Python's pickle format, read without running anything that they name."""
