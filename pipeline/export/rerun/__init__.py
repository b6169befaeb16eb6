"""Rerun file of a take, for people who look for the cause of an error: what was seen and what was found."""
