"""Calibration from people who walk about: cameras of known or guessed intrinsics, no board."""
