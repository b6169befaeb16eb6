"""Readers of keypoint formats: one module a format, or a family of formats."""
