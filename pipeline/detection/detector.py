"""Detector of the registry: bodies, or part affinity fields, in the pixels of an image."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, UInt8

from pipeline.core.data.arrays import read_only
from pipeline.core.data.turns import upright_size_px
from pipeline.core.errors import ModelError
from pipeline.core.joints import JointSet
from pipeline.detection.bodies import ImageBodies, boxes_around
from pipeline.detection.decoders.fields import ImageFields, grid_on_image
from pipeline.detection.decoders.grouping import group
from pipeline.detection.decoders.movenet import decode_movenet
from pipeline.detection.decoders.openpose import LIMBS, decode_openpose
from pipeline.detection.entries import find_entry
from pipeline.detection.letterbox import LetterBox, apply_letterbox, fit_letterbox
from pipeline.detection.models import verify
from pipeline.detection.network import Network, open_network
from pipeline.detection.providers.find import current_provider
from pipeline.detection.registry import FieldGrid, NetworkEntry, NetworkHead, NetworkInput

__all__ = ["Detector", "ImageBodies", "open_detector"]


@dataclass(frozen=True, slots=True)
class Detector:
    """Detector of bodies in single images."""

    network: Network  # Function that runs the network
    # Input and output of the network; see ``registry.NetworkEntry``
    input: NetworkInput
    head: NetworkHead
    joints: JointSet
    fields: FieldGrid | None = None  # Grid of the part affinity fields; ``None`` for a network without fields
    turn_deg: float = 0.0  # Counterclockwise turn that brings images upright before the network sees them

    def detect(self, image_rgb: UInt8[np.ndarray, "height width 3"]) -> ImageBodies:
        """Detect the bodies in an image, in pixels of the image."""
        tensor, letterbox = self.prepare(image_rgb)
        return self.decode(self.run_network(tensor), letterbox)

    def detect_fields(self, image_rgb: UInt8[np.ndarray, "height width 3"]) -> ImageFields:
        """Detect peaks and part affinity fields in an image; ``ValueError`` for a network without fields."""
        tensor, letterbox = self.prepare(image_rgb)
        return self._decode_fields(self.run_network(tensor), letterbox)

    def prepare(
        self, image_rgb: UInt8[np.ndarray, "height width 3"]
    ) -> tuple[Float32[np.ndarray, "1 3 padded_height padded_width"], LetterBox]:
        """Fit an image into the network's input, and return how."""
        height, width = image_rgb.shape[:2]
        scale = self.input.scale(upright_size_px((width, height), self.turn_deg))
        letterbox = fit_letterbox((width, height), scale, self.input.multiple, self.turn_deg)
        padded = apply_letterbox(image_rgb, letterbox)
        channels = padded if self.input.channels == "rgb" else padded[..., ::-1]
        return np.ascontiguousarray(channels.transpose(2, 0, 1)[None], np.float32), letterbox

    def run_network(self, tensor: Float32[np.ndarray, "1 3 height width"]) -> Mapping[str, np.ndarray]:
        """Run the network on a prepared tensor; returns its named outputs."""
        return self.network(tensor)

    def decode(self, outputs: Mapping[str, np.ndarray], letterbox: LetterBox) -> ImageBodies:
        """Decode the network's outputs to bodies in pixels of the image."""
        if self.head is NetworkHead.OPENPOSE:
            return group(self._decode_fields(outputs, letterbox), LIMBS, len(self.joints.names))
        bodies = decode_movenet(outputs)
        keypoints_px = letterbox.image_from_network(bodies.keypoints_px)
        return replace(bodies, keypoints_px=read_only(keypoints_px), box_px=read_only(boxes_around(keypoints_px)))

    def _decode_fields(self, outputs: Mapping[str, np.ndarray], letterbox: LetterBox) -> ImageFields:
        if self.fields is None:
            raise ValueError("The network gives no part affinity fields.")
        return decode_openpose(outputs, grid_on_image(self.fields, letterbox), letterbox.image_size_px)


def open_detector(name: str = "movenet-multipose") -> Detector:
    """Open an installed network of the registry.

    Raises ``ModelError`` if it is unknown or not installed, its file was changed, or it reads crops.
    """
    entry = find_entry(name)
    if entry.head.reads_crops or entry.own is not None:
        raise ModelError(f"{name} reads landmarks in crops, which other networks find: it is not a detector by itself.")
    return Detector(open_network(verify(_to_run(entry))), entry.input, entry.head, entry.joints, entry.fields)


def _to_run(entry: NetworkEntry) -> str:
    """Name of the network that this process's provider runs for a network of the registry."""
    if entry.single_precision is None or not current_provider().is_gpu:
        return entry.name
    return entry.single_precision
