"""Checks of a session's pictures, a few of each camera, before anybody is detected in them."""
