"""Motion of a job for viewers."""
