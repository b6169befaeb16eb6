"""Recordings: rooms in which browsers of phones record takes together, and sessions that are made of them."""
