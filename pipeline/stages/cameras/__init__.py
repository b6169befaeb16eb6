"""Measurements of a session's cameras from its people: their clocks and their poses."""
