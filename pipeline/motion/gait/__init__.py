"""Gait and movement of a person: events, strides and their figures, jumps, squats, sitting down and standing up."""
