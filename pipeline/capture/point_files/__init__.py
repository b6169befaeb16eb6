"""Files of 3D points of other systems, which a confined child process opens: tables of named points."""
