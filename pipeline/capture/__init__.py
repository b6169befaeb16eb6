"""A capture session out of files: videos or keypoints, and the calibration of their cameras."""
