"""Networks of other formats to ONNX, without the frameworks that they were made with."""
