"""World of a calibration from points whose coordinates are known."""
