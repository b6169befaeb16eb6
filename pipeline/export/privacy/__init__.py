"""Privacy: regions of heads in the pictures of cameras, and pictures in which they are unrecognisable."""
