"""Readers of calibration formats: one module a format, or a family of formats."""
