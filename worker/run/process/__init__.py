"""Processes of the service: start, supervision and end, log files, priorities, temporary folders."""
