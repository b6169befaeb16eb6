"""Checks of a session before its reconstruction: pictures, clocks, and people at a few instants."""
