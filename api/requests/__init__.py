"""Requests: their bodies, limits and validation; what a session is made of."""
