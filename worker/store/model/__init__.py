"""Records of the job store, and the states of jobs and chunks."""
