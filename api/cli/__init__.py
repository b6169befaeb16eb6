"""Command line ``multicap``: its commands, and the client of a service."""
