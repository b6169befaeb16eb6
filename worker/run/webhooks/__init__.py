"""Webhooks: messages about the ends of jobs, sent to URLs of clients."""
