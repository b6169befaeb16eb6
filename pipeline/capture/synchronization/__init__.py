"""Synchronisation of cameras from people's motion: arrays in, arrays out."""
