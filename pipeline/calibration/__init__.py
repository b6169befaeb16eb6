"""Readers of calibration files: one module a format, and a registry that chooses the reader."""
