"""Sequences of images in place of a video: a folder or a zip archive of a camera."""
