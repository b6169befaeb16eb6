"""Interfaces of Multicap: the web API and the command line."""
