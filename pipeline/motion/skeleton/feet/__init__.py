"""Feet on the floor: height of the floor, contacts of feet, and positions of standing feet."""
