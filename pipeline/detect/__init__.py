"""2D joint detection: registry of networks, ONNX Runtime sessions, and decoders of network outputs."""
