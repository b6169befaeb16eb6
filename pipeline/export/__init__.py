"""Writers of result files: each module encodes a motion or tracks into bytes."""
