"""Durable jobs, and who runs them."""
