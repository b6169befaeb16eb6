"""Capture sessions: how they come in, their check, their videos and thumbnails."""
