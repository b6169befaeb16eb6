"""Motion for viewers: ``motion.bin`` holds frames, ``motion.json`` describes them (docs/reference/file-contents.md)."""
