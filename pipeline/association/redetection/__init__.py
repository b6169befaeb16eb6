"""Second detection of leaning and close bodies, where their tracks expect them (docs/lab/detection.md)."""
