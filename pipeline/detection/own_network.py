"""Description of a network of the user's own, stored as JSON beside its ONNX file."""

import json
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from pipeline.core.errors import ModelError
from pipeline.core.layouts import LAYOUTS

OwnHead = Literal["simcc", "heatmaps", "rtmo"]
"""Kinds of outputs: SimCC (RTMPose, RTMW) and heatmaps (ViTPose) of one person's crop, RTMO's people of an image."""
HEADS: tuple[OwnHead, ...] = get_args(OwnHead)
Channels = Literal["rgb", "bgr"]

# Mean and standard deviation of ImageNet's colours, with which most networks of crops were trained.
_IMAGENET = ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375))
_AS_IT_IS = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


@dataclass(frozen=True, slots=True)
class OwnNetwork:
    """Network of the user's own."""

    head: OwnHead  # Kind of the outputs
    layout: str  # Name of the layout of its keypoints in ``pipeline.core.layouts.LAYOUTS``
    input_px: tuple[int, int]  # Width and height of the input
    channels: Channels  # Order of the colour channels
    # Subtracted from the values 0..255 of each channel, and by what the difference is divided
    mean: tuple[float, float, float]
    std: tuple[float, float, float]

    @property
    def reads_crops(self) -> bool:
        """Return whether the network takes the crop of one person."""
        return self.head != "rtmo"


def usual_network(head: OwnHead, layout: str, input_px: tuple[int, int] | None = None) -> OwnNetwork:
    """Describe a network as networks of its kind are usually trained.

    Without ``input_px``, width and height of the input are the same as in the smallest published networks.
    """
    if head == "rtmo":
        return OwnNetwork(head, layout, input_px or (640, 640), "bgr", *_AS_IT_IS)
    return OwnNetwork(head, layout, input_px or (192, 256), "rgb", *_IMAGENET)


def encode_description(network: OwnNetwork) -> bytes:
    """Encode a description; equal descriptions give equal bytes."""
    return json.dumps(asdict(network), indent=2, sort_keys=True).encode()


def decode_description(content: bytes, filename: str) -> OwnNetwork:
    """Decode a description. Raises ``ModelError`` if the content is damaged; the message names the file."""
    try:
        fields: dict[str, Any] = json.loads(content)
        width, height = (int(side) for side in fields["input_px"])
        mean, std = (tuple(float(value) for value in fields[name]) for name in ("mean", "std"))
        head, layout, channels = fields["head"], fields["layout"], fields["channels"]
        is_known = head in HEADS and layout in LAYOUTS and channels in get_args(Channels)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise _damaged(filename) from error
    if not is_known or min(width, height) < 1 or len(mean) != 3 or len(std) != 3 or 0.0 in std:
        raise _damaged(filename)
    return OwnNetwork(head, layout, (width, height), channels, mean, std)


def _damaged(filename: str) -> ModelError:
    return ModelError(f"{filename} is damaged. Add the network again: multicap models add FILE --head HEAD ...")
