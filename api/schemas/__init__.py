"""Bodies of requests and responses as Pydantic models; the stored records are in ``worker.jobs.model``."""
