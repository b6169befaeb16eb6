"""Stages of a job, as workers run them."""
