"""Work on jobs: Celery tasks, the runner of a chunk, leases, the reaper, processes, webhooks, telemetry.

Imports ``worker.store`` and ``pipeline``.
"""
