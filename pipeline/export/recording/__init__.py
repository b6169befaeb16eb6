"""Recordings of a take for Rerun, for people who look for the cause of an error: what was seen and what was found."""
