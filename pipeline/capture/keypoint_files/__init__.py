"""Files of 2D joints that other programs detected: a reader a format, folders of cameras, timestamps."""
