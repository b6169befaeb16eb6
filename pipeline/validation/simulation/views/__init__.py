"""Simulated 2D detection: occlusion, noise, faults, heatmaps and part affinity fields."""
