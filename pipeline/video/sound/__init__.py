"""Sound of videos: its loudness, read in child processes with limits."""
