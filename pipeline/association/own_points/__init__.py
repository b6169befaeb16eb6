"""Points of the user's own: located beside people, or as objects of the scene."""
