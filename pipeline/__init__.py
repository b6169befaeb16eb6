"""Reconstruction pipeline: from videos of calibrated cameras to animated skeletons. Imports nothing of the service."""
