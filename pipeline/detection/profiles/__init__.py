"""Detection by the networks of a profile: the size of the images that the networks get, and their detectors."""
