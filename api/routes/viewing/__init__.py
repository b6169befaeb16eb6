"""Routes for viewers: videos of sessions, and links for people and requests without a key."""
