"""The face of Multicap: the command line and, on top of the same library, the web service."""
