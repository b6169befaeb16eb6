"""Hands: fingers fitted on the wrists of a body that was fitted before."""
