"""People of a job: who was found, and edits that put them right."""
