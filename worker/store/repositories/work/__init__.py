"""Repositories of the work: chunks with their leases and outputs, plans, and worker processes."""
