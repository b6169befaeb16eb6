"""Simulation of people, camera rigs and detector noise with exact ground truth."""
