"""Webhooks: messages about the ends of jobs, sent to clients' addresses."""
