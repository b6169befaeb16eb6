"""`multicap benchmark all`: cost of a job by profile, provider, cores, cameras, people and length."""
