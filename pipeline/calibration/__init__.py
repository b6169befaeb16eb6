"""Readers of calibration files, one module a format, one registry."""
