"""Simulated people: scripts, and where every joint is at any time."""
