"""Motion for viewers: ``motion.bin`` holds frames, ``motion.json`` describes them (docs/lab/format-notes.md)."""
