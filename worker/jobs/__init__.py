"""The contract between the API and the workers: sessions, jobs, stages and chunks as rows."""
