"""Clustering of one instant: joints in space from 2D candidates, people from joints."""
