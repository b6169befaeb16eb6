"""Bundle adjustment: cameras and points, or rigid bodies of points, fitted together to observations."""
