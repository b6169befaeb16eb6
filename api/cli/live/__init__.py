"""Listeners of `multicap live`: lines of JSON, kept keypoints, a page, the terminal."""
