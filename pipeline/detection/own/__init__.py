"""Networks of the user's own: ONNX files of known kinds, checked, stored and run."""
