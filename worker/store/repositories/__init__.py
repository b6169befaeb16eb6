"""Repositories: each module reads and writes the rows of one resource."""
