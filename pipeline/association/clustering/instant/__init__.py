"""Hypothesis clustering at one instant: 3D joints from 2D candidates, and poses from joints."""
