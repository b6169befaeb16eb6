"""Refinement of a given calibration from the people of a take."""
