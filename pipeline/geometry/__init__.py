"""Cameras, rigid transforms, triangulation and epipolar geometry: arrays in, arrays out."""
