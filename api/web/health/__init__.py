"""Health of the service: liveness, readiness, metrics."""
