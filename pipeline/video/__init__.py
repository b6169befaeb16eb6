"""Probing and decoding of video files, and the clock that the cameras share."""
