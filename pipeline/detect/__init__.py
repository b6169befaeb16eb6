"""2D joint detection: the registry of networks, ONNX Runtime sessions and decoders of network heads."""
