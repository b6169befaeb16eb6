"""Calibration from a board that the cameras film."""
