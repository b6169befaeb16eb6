"""Files of characters in motion: GLB and FBX with the character's own mesh, BVH of its bones."""
