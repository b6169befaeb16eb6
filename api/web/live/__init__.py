"""Live captures over a WebSocket: keypoints in, people out, while it happens."""
