"""People, rigs and detector noise with exact truth."""
