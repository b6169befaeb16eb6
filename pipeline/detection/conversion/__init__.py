"""Conversion of networks of other formats to ONNX, without their frameworks."""
