"""Rows of one resource each: read, written, and moved from state to state."""
