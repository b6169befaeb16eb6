"""Motion of simulated people: scripts, walking, gestures and joint positions over time."""
