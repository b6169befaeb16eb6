"""Probe of an execution provider, ``python -m``: run a network of one operator on it, and print what it tells as JSON.

A process of its own: a driver that crashes or hangs ends this one alone, and processes that are forked later inherit
no state of a device.
"""

import json
import sys
from typing import get_args

import numpy as np
import onnx
from onnx import TensorProto, helper

from pipeline.core.options.providers import Provider, ProviderName
from pipeline.core.options.rules import install_command
from pipeline.detection.entries import REGISTRY
from pipeline.detection.models import status
from pipeline.detection.providers.open import device_name, open_session


def main() -> None:
    """Probe the provider of the first argument."""
    (name,) = (name for name in get_args(ProviderName) if name == sys.argv[1])
    if missing := _missing_networks(name):
        sys.stdout.write(json.dumps({"problem": f"{' and '.join(missing)} is missing. {install_command(*missing)}"}))
        return
    try:
        session = open_session(_doubling().SerializeToString(), name)
        (doubled,) = session.run(None, {"image": np.ones((1, 3, 8, 8), np.float32)})
        found = {"device": device_name(name)} if (doubled == 2).all() else {"problem": "it computes wrong values"}
    except Exception as error:  # ONNX Runtime's errors have no common base
        found = {"problem": " ".join(str(error).split())[:300] or type(error).__name__}
    sys.stdout.write(json.dumps(found))


def _missing_networks(name: ProviderName) -> list[str]:
    """Networks in single precision that GPUs run for installed networks, and that are not installed themselves."""
    if not Provider(name).is_gpu:
        return []
    installed = {network.name for network in status() if network.installed}
    twins = (entry.single_precision for entry in REGISTRY.values() if entry.name in installed)
    return [twin for twin in twins if twin is not None and twin not in installed]


def _doubling() -> onnx.ModelProto:
    """Network that adds an image to itself by a convolution, which needs the libraries that real networks need."""
    shape = [1, 3, 8, 8]
    weights = helper.make_tensor("weights", TensorProto.FLOAT, [3, 3, 1, 1], (2 * np.eye(3)).ravel())
    graph = helper.make_graph(
        [helper.make_node("Conv", ["image", "weights"], ["doubled"])],
        "doubling",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("doubled", TensorProto.FLOAT, shape)],
        [weights],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


if __name__ == "__main__":
    main()
