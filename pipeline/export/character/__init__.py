"""Characters of the user's own: read, their bones recognised, motion retargeted onto them, files written."""
