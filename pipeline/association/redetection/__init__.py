"""Second detection of leaning bodies, at the places where their tracks expect them (docs/lab/detection.md)."""
