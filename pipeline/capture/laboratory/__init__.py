"""Laboratory files beside the cameras: C3D with force plates, analog channels and events, and their clock."""
