"""Identity of people over a whole session: tracks are cut where they are in doubt, and joined by a global pass."""
