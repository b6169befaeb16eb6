"""Files of characters in motion: GLB with the character's own mesh, BVH of its bones."""
