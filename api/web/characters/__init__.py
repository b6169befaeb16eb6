"""Characters of the user's own: sent as files, their bones recognised and corrected."""
