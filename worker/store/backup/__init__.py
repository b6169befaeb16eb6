"""Backups: everything that a service keeps, in one file, made while the service runs."""
