"""run_litert.py MODEL CROPS.npy OUTPUTS.npz: outputs of a TensorFlow Lite model for images NHWC, by LiteRT.

It runs in an environment of its own, without Multicap.
"""

import sys
from typing import Any

import numpy as np
from ai_edge_litert.interpreter import Interpreter, OpResolverType

model, crops, outputs = sys.argv[1:]
# The kernels of TensorFlow Lite itself: delegates are faster and less exact.
kernels = OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES
interpreter = Interpreter(model_path=model, experimental_op_resolver_type=kernels)
interpreter.allocate_tensors()
(entry,) = interpreter.get_input_details()
results: dict[str, list[np.ndarray]] = {}
for crop in np.load(crops):
    interpreter.set_tensor(entry["index"], crop[None])
    interpreter.invoke()
    for detail in interpreter.get_output_details():
        results.setdefault(detail["name"], []).append(interpreter.get_tensor(detail["index"])[0])
arrays: Any = {name: np.array(values) for name, values in results.items()}
np.savez(outputs, **arrays)
