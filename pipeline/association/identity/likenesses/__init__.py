"""Likenesses of people: pictures of them that never move, and their mirror images."""
