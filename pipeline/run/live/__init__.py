"""Capture while it happens: frames of cameras in, people and their skeletons out."""
