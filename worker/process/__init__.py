"""Processes of the service: start, supervise and end them, and what each one needs."""
