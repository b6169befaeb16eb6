"""Logs as JSON, and traces by OpenTelemetry."""
