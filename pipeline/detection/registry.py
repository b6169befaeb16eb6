"""Types of the registry of networks: source, conversion, checksums, input and output.

The weights of a network come from a pinned package or from the user's files, and are converted to ONNX. Checksums pin
the package, the weights and the ONNX file. ``entries`` lists the networks.
"""

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from pipeline.core.joints import JointOffsets, JointSet
from pipeline.core.runtime.packages.index import PinnedFile
from pipeline.detection.own_network import OwnNetwork


class NetworkHead(enum.Enum):
    """Kind of a network's outputs, which selects the decoder."""

    MOVENET_MULTIPOSE = "movenet-multipose"
    OPENPOSE = "openpose"
    BLAZEPOSE = "blazepose"
    HAND = "hand"
    OWN = "own"

    @property
    def reads_crops(self) -> bool:
        """Return whether the network reads landmarks in a crop of a body or hand, not whole images."""
        return self in {NetworkHead.BLAZEPOSE, NetworkHead.HAND}


@dataclass(frozen=True, slots=True)
class PackagedWeights:
    """Weights inside a package."""

    package: PinnedFile  # File of the package
    # Path to the weights through nested archives: a member of the package, a member of that archive, and so on
    members: tuple[str, ...]
    # Checksum and size of the weights
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
    """Weights that are in no package, as files of one folder."""

    files: tuple[WeightFile, ...]  # Files in the order of the conversion's arguments


@dataclass(frozen=True, slots=True)
class NetworkInput:
    """Input of a network: a float tensor (1, 3, height, width)."""

    channels: Literal["rgb", "bgr"]  # Order of the colour channels
    multiple: int  # Number of which height and width must be multiples
    # Length to which an image is scaled, and the side that gets this length. Networks with fields need people of a
    # certain size; the image's height bounds the size of standing people. Crops are squares of this side.
    scaled_px: int
    scaled_side: Literal["long", "height"] = "long"

    def scale(self, image_size_px: tuple[int, int]) -> float:
        """Pixels of the network's input for each image pixel, for an image of this width and height."""
        return self.scaled_px / (max(image_size_px) if self.scaled_side == "long" else image_size_px[1])


@dataclass(frozen=True, slots=True)
class FieldGrid:
    """Grid of a network's maps on its input, and the threshold of its part affinity fields."""

    stride_px: int  # Size of a cell in pixels of the input
    shift_px: tuple[float, float]  # Offset of the network's maps to the right and downwards, in pixels of the input
    # Least connectivity score of connected joints (Chen et al. 2020, eq. 2); depends on the network, 0.3 in the paper
    tau2: float


@dataclass(frozen=True, slots=True)
class NetworkEntry:
    """A network of the registry."""

    name: str  # Name of the network; of a detector, that in ``pipeline.core.options.config.NETWORKS``
    # Source of the weights, and their conversion to ONNX
    source: PackagedWeights | LooseWeights
    convert: Callable[[Sequence[bytes]], bytes]
    # Checksum and size of the ONNX file
    sha256: str
    num_bytes: int
    licence: str  # SPDX identifier of the weights' licence
    # Input, kind of the outputs, and joints that the network detects
    input: NetworkInput
    head: NetworkHead
    joints: JointSet
    # Name of the same network in single precision, which GPUs run instead: integers of 8 bits gain nothing there, and
    # joints depend on how each processor rounds them
    single_precision: str | None = None
    fields: FieldGrid | None = None  # Grid of the part affinity fields; ``None`` for a network without fields
    # Offsets of the network's marks from the centres of the joints, learnt from rendered people (docs/lab/fit-notes.md)
    offsets: JointOffsets = field(default_factory=dict)
    # Description of a network of the user's own; ``None`` for the networks of the registry
    own: OwnNetwork | None = None
