"""Sides: left and right limbs of a person, decided over all views and over time together."""
