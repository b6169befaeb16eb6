"""Readers of captures with a known truth, and their scores."""
