"""Result files: each module encodes a motion or tracks into pieces of a file, and reads positions back out of it."""
