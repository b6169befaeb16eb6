"""Outputs of `multicap live` about people while they are captured: lines of JSON, kept keypoints, VMC, the terminal."""
