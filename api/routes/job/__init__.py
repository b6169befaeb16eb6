"""Routes of a job: its course, events, results, motion and people."""
