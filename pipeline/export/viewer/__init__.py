"""Motion for viewers: ``motion.bin`` holds frames, ``motion.json`` describes them; see docs/reference/formats.md."""
