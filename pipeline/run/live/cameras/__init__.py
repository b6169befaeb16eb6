"""Cameras of a live capture: streams opened and decoded in child processes, people detected in the newest pictures."""
