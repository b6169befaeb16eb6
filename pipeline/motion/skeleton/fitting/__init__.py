"""Skeleton fit: rotations of a skeleton of constant bone lengths, fit to what all views saw."""
