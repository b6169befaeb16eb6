"""Callers: their tenant, quotas, and browsers that sign in."""
