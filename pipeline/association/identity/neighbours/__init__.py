"""Limbs that detectors take from a neighbour, given to the person whom they show."""
