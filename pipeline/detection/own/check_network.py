"""Check of an untrusted ONNX file, a confined program.

``python -m pipeline.detection.own.check_network FILE WIDTH HEIGHT`` prints one JSON object: ``problem``, or
``input`` (the shape, null for an open axis) and ``outputs``, the shapes that the network gives for a black image.
"""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime

from pipeline.core.runtime.confinement import confined_arguments, tell_ready

_DOMAINS = {"", "ai.onnx"}
# Reasons of ONNX Runtime for models that are too new.
_NEW_OPSET = re.compile(r"Opset (\d+) is under development.* till opset (\d+)", re.DOTALL)
_NEW_IR = re.compile(r"Unsupported model IR version: (\d+), max supported IR version: (\d+)")
# Text of ONNX Runtime before the reason: its code, the file, the node, and a place in its source. The operator stays.
_PREAMBLE = re.compile(
    r"\[ONNXRuntimeError\] : \d+ : \w+ : |Load model from .* failed: ?|Exception during initialization: |"
    r"(?:Non-zero status code returned while running |This is an invalid model\. In Node, \(\"[^\"]*\", )(\w+)"
    r"(?: node\. Name:'[^']*' Status Message: |,.* , Error )|"
    r"\S*\.(?:h|hpp|cc|cpp):\d+ [^()]*\([^()]*\)(?: const)? "
)
_MAX_REASON = 1000


def main() -> None:
    """Check a file, and print the result."""
    path, width, height = confined_arguments()
    tell_ready()
    try:
        result = check(Path(path), (int(width), int(height)))
    except Exception as error:
        result = {"problem": reason(str(error).strip() or type(error).__name__)}
    sys.stdout.write(json.dumps(result))


def reason(message: str) -> str:
    """Reason for which a model can't be run, from a message of ONNX Runtime or of the package onnx.

    >>> reason("[ONNXRuntimeError] : 1 : FAIL : Load model from a.onnx failed:/src/a.cc:7 void f(int) No shape.")
    "it is damaged or can't be run (No shape)"
    """
    if new := _NEW_OPSET.search(message):
        opset, newest = new.groups()
        return (
            f"its opset is {opset}, and ONNX Runtime {onnxruntime.__version__} reads opsets up to {newest}; export it "
            f"with opset {newest} or an older one"
        )
    if new := _NEW_IR.search(message):
        version, newest = new.groups()
        return (
            f"its IR version is {version}, and ONNX Runtime {onnxruntime.__version__} reads versions up to {newest}; "
            "export it with an older version of the package onnx"
        )
    text = " ".join(_PREAMBLE.sub(lambda part: f"{part[1]}: " if part[1] else "", message).split()).removesuffix(".")
    # Reasons stand at the end.
    return f"it is damaged or can't be run ({text[-_MAX_REASON:]})"


def check(path: Path, input_px: tuple[int, int]) -> dict[str, Any]:
    """Check a file, and run the network on a black image of a size, unless its own input has a fixed size."""
    model = onnx.load(path, load_external_data=False)
    if problem := _problem(model):
        return {"problem": problem}
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # First, since it says which versions it reads; the package onnx reads others.
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    onnx.checker.check_model(model)
    inputs = session.get_inputs()
    if len(inputs) != 1 or inputs[0].type != "tensor(float)" or len(inputs[0].shape) != 4:
        return {"problem": "it must have one input of float32: (1, 3, height, width)"}
    shape = [size if isinstance(size, int) else None for size in inputs[0].shape]
    asked = (1, 3, input_px[1], input_px[0])
    image = np.zeros([size or other for size, other in zip(shape, asked, strict=True)], np.float32)
    names = [output.name for output in session.get_outputs()]
    values = session.run(names, {inputs[0].name: image})
    return {"input": shape, "outputs": {name: list(value.shape) for name, value in zip(names, values, strict=True)}}


def _problem(model: onnx.ModelProto) -> str | None:
    if model.functions:
        return "it has functions of its own; export it with standard operators only"
    for node in _nodes(model.graph):
        if node.domain not in _DOMAINS:
            return f"it needs the operator {node.op_type} of {node.domain}; export it with standard operators only"
    if any(tensor.data_location == onnx.TensorProto.EXTERNAL for tensor in _tensors(model.graph)):
        return "its weights are in another file; export it as one file"
    return None


def _graphs(graph: onnx.GraphProto) -> Iterator[onnx.GraphProto]:
    yield graph
    for node in graph.node:
        for attribute in node.attribute:
            for inner in (*([attribute.g] if attribute.HasField("g") else ()), *attribute.graphs):
                yield from _graphs(inner)


def _nodes(graph: onnx.GraphProto) -> Iterator[onnx.NodeProto]:
    for inner in _graphs(graph):
        yield from inner.node


def _tensors(graph: onnx.GraphProto) -> Iterator[onnx.TensorProto]:
    for inner in _graphs(graph):
        yield from inner.initializer
    for node in _nodes(graph):
        for attribute in node.attribute:
            yield from (*([attribute.t] if attribute.HasField("t") else ()), *attribute.tensors)


if __name__ == "__main__":
    main()
