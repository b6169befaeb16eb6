"""Stored files: artifact stores, copies on this machine, checksums, removals."""
