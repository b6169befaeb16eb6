"""Execution providers of ONNX Runtime: what runs the networks on this machine."""
