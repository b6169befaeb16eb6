"""Reconstruction from the outputs of stages, and what is made of it for people to look at."""
