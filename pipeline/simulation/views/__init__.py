"""Simulated detections: occlusion, noise, faults, heatmaps and fields."""
