"""Detectors of bodies with a network of the user's own: in the crops of another detector's bodies, or in one stage."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from pipeline.core.data.arrays import read_only
from pipeline.core.joints import JointSet
from pipeline.core.layouts import LAYOUTS
from pipeline.detection.bodies import BodyDetector, ImageBodies
from pipeline.detection.letterbox import LetterBox, PictureTurn, apply_letterbox
from pipeline.detection.network import Network
from pipeline.detection.own_network import OwnNetwork

_BLUR_CELLS = 11
_LEAST = 1e-10


def decode_heatmaps(
    maps: Float[np.ndarray, "points rows columns"], input_px: tuple[int, int]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Decode the points of one crop.

    ``maps`` are confidences of cells, ``input_px`` is the size of the network's input. Returns pixels of the input, and
    confidences in [0, 1].
    """
    num_rows, num_columns = maps.shape[1:]
    rows, columns = np.divmod(maps.reshape(len(maps), -1).argmax(1), num_columns)
    cells = np.array(
        [_refine(each, int(row), int(column)) for each, row, column in zip(maps, rows, columns, strict=True)]
    )
    pixels_per_cell = (np.array(input_px) - 1) / (num_columns - 1, num_rows - 1)
    return cells.reshape(-1, 2) * pixels_per_cell, maps.max((1, 2)).astype(np.float64).clip(0, 1)


def _refine(heat: Float[np.ndarray, "rows columns"], row: int, column: int) -> tuple[float, float]:
    """Position (x, y) of a peak in cells."""
    num_rows, num_columns = heat.shape
    if not (1 <= row < num_rows - 1 and 1 <= column < num_columns - 1):
        return float(column), float(row)
    blurred = cv2.GaussianBlur(heat.astype(np.float64), (_BLUR_CELLS, _BLUR_CELLS), 0)
    around = np.log(blurred[row - 1 : row + 2, column - 1 : column + 2].clip(_LEAST))
    slope = np.array([around[1, 2] - around[1, 0], around[2, 1] - around[0, 1]]) / 2
    mixed = (around[2, 2] - around[2, 0] - around[0, 2] + around[0, 0]) / 4
    curvature = np.array(
        [
            [around[1, 2] - 2 * around[1, 1] + around[1, 0], mixed],
            [mixed, around[2, 1] - 2 * around[1, 1] + around[0, 1]],
        ]
    )
    # A maximum curves downwards along both axes; anything else is a flat map.
    if curvature[0, 0] >= 0 or np.linalg.det(curvature) <= 0:
        return float(column), float(row)
    step = np.clip(-np.linalg.solve(curvature, slope), -1, 1)
    return float(column + step[0]), float(row + step[1])


_MIN_POSE_SCORE = 0.3


def decode_simcc(
    bins_x: Float[np.ndarray, "points columns"], bins_y: Float[np.ndarray, "points rows"], input_px: tuple[int, int]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Decode the points of one crop: coordinates as classes, one row of bins an axis (Li et al., ECCV 2022).

    RTMPose and RTMW have this head.

    ``bins_x``, ``bins_y``: confidence of each bin; the bins divide the input's width and height evenly. ``input_px``:
    width and height of the network's input. Returns pixels of the input, and confidences in [0, 1]: of the less certain
    axis.
    """
    columns, rows = bins_x.argmax(1), bins_y.argmax(1)
    points_px = np.stack([columns * (input_px[0] / bins_x.shape[1]), rows * (input_px[1] / bins_y.shape[1])], axis=-1)
    return points_px, np.minimum(bins_x.max(1), bins_y.max(1)).astype(np.float64).clip(0, 1)


def decode_rtmo(
    boxes: Float[np.ndarray, "people 5"], keypoints: Float[np.ndarray, "people points 3"]
) -> tuple[Float[np.ndarray, "n points 2"], Float[np.ndarray, "n points"], Float[np.ndarray, " n"]]:
    """Decode the people of one image (Lu et al., CVPR 2024); duplicates were removed by the network.

    Boxes are x0, y0, x1, y1 and confidence, points x, y and confidence. Returns pixels of the network's input,
    confidences in [0, 1] of points and of people, in descending order.
    """
    order = np.argsort(-boxes[:, 4], kind="stable")
    chosen = order[boxes[order, 4] > _MIN_POSE_SCORE]
    joints_px = keypoints[chosen].astype(np.float64)
    return joints_px[..., :2], joints_px[..., 2].clip(0, 1), boxes[chosen, 4].astype(np.float64).clip(0, 1)


# Joints of the other detector that count for a person's box, and the box's size in sizes of the joints' box: networks
# are trained with 1.25 boxes of whole people, who reach farther than their joints.
_MIN_BODY_SCORE = 0.2
_BOX_FACTOR = 1.4
_MIN_BOX_PX = 16.0
# Points below are not kept.
_MIN_SCORE = 0.2
# Grey of RTMO's padding.
_PADDING = 114


@dataclass(frozen=True, slots=True)
class OwnInCrops:
    """Detector that reads the joints of each body in its crop."""

    body: BodyDetector  # Detector that finds the bodies
    # Network of crops and its description
    network: Network
    own: OwnNetwork
    turn_deg: float = 0.0  # Counterclockwise turn that brings images upright

    @property
    def joints(self) -> JointSet:
        """Joints of the bodies."""
        return LAYOUTS[self.own.layout].joints

    def detect(self, image_rgb: UInt8[np.ndarray, "height width 3"]) -> ImageBodies:
        """Detect the bodies in an image, in pixels of the image."""
        bodies = self.body.detect(image_rgb)
        keypoints_px = np.full((len(bodies.score), len(self.joints.names), 2), np.nan)
        score = np.zeros(keypoints_px.shape[:2])
        for number, (joints_px, confidence) in enumerate(zip(bodies.keypoints_px, bodies.score, strict=True)):
            seen_px = joints_px[confidence >= _MIN_BODY_SCORE]
            if len(seen_px) > 1:
                keypoints_px[number], score[number] = self._read(image_rgb, seen_px)
        return _bodies(keypoints_px, score, bodies.center_score)

    def _read(
        self, image_rgb: UInt8[np.ndarray, "height width 3"], seen_px: Float[np.ndarray, "seen 2"]
    ) -> tuple[Float[np.ndarray, "joints 2"], Float[np.ndarray, " joints"]]:
        height, width = image_rgb.shape[:2]
        crop_from_image = crop_matrix(seen_px, self.own, PictureTurn((width, height), self.turn_deg))
        crop = cv2.warpAffine(image_rgb, crop_from_image, self.own.input_px, flags=cv2.INTER_LINEAR)
        outputs = [output[0] for output in self.network(as_input(crop, self.own)).values()]
        decoded = (
            decode_simcc(outputs[0], outputs[1], self.own.input_px)
            if self.own.head == "simcc"
            else decode_heatmaps(outputs[0], self.own.input_px)
        )
        points_px, score = decoded
        used = LAYOUTS[self.own.layout].indices
        image_px = (points_px - crop_from_image[:, 2]) @ np.linalg.inv(crop_from_image[:, :2]).T
        return image_px[used], score[used]


@dataclass(frozen=True, slots=True)
class OwnInOneStage:
    """Detector that finds all people of an image by one network."""

    # Network of whole images and its description
    network: Network
    own: OwnNetwork
    turn_deg: float = 0.0  # Counterclockwise turn that brings images upright

    @property
    def joints(self) -> JointSet:
        """Joints of the bodies."""
        return LAYOUTS[self.own.layout].joints

    def detect(self, image_rgb: UInt8[np.ndarray, "height width 3"]) -> ImageBodies:
        """Detect the bodies in an image, in pixels of the image."""
        height, width = image_rgb.shape[:2]
        turn = PictureTurn((width, height), self.turn_deg)
        turned_width, turned_height = turn.size_px
        scale = min(self.own.input_px[0] / turned_width, self.own.input_px[1] / turned_height)
        size = (max(1, int(turned_width * scale)), max(1, int(turned_height * scale)))
        letterbox = LetterBox(turn.image_size_px, size, self.own.input_px, self.turn_deg)
        padded = apply_letterbox(image_rgb, letterbox, _PADDING)
        boxes, keypoints = _boxes_and_keypoints(self.network(as_input(padded, self.own)))
        points_px, score, center_score = decode_rtmo(boxes, keypoints)
        used = LAYOUTS[self.own.layout].indices
        return _bodies(turn.to_image(points_px[:, used] / scale), score[:, used], center_score)


def open_own(network: Network, own: OwnNetwork, body: BodyDetector | None, turn_deg: float = 0.0) -> BodyDetector:
    """Make the detector of a network of one's own; ``body`` finds the people for networks of crops.

    ``turn_deg`` is the counterclockwise turn that brings images upright; ``body`` turns them likewise.
    """
    if not own.reads_crops:
        return OwnInOneStage(network, own, turn_deg)
    if body is None:
        raise ValueError("A network of crops needs another detector.")
    return OwnInCrops(body, network, own, turn_deg)


def crop_matrix(seen_px: Float[np.ndarray, "seen 2"], own: OwnNetwork, turn: PictureTurn) -> Float[np.ndarray, "2 3"]:
    """Pixels of a network's input from pixels of the image, for the box around joints in the turned image.

    The centre of the box becomes the centre of the input. Networks of heatmaps count pixels from the first to the last
    (UDP), networks of SimCC from edge to edge.
    """
    width, height = own.input_px
    turned_px = turn.to_turned(seen_px)
    low, high = turned_px.min(0), turned_px.max(0)
    box_width, box_height = np.maximum((high - low) * _BOX_FACTOR, _MIN_BOX_PX)
    box_width = max(box_width, box_height * width / height)
    shorter = 1 if own.head == "heatmaps" else 0
    scale = (width - shorter) / box_width
    shift = np.array([width - shorter, height - shorter]) / 2 - (low + high) / 2 * scale
    if turn.turn_deg == 0.0:
        return np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    crop_from_image = scale * turn.turned_from_image
    crop_from_image[:, 2] += shift
    return crop_from_image


def as_input(
    image_rgb: UInt8[np.ndarray, "height width 3"], own: OwnNetwork
) -> Float32[np.ndarray, "1 3 height width"]:
    """Image as the input of a network: order of channels, mean and standard deviation."""
    channels = image_rgb if own.channels == "rgb" else image_rgb[..., ::-1]
    normalised = (channels.astype(np.float32) - np.array(own.mean, np.float32)) / np.array(own.std, np.float32)
    return np.ascontiguousarray(normalised.transpose(2, 0, 1)[None], np.float32)


def _boxes_and_keypoints(
    outputs: Mapping[str, np.ndarray],
) -> tuple[Float[np.ndarray, "people 5"], Float[np.ndarray, "people points 3"]]:
    boxes, keypoints = sorted((output[0] for output in outputs.values()), key=np.ndim)
    return boxes, keypoints


def _bodies(
    keypoints_px: Float[np.ndarray, "n joints 2"],
    score: Float[np.ndarray, "n joints"],
    center_score: Float[np.ndarray, " n"],
) -> ImageBodies:
    """Bodies of points that are certain enough; bodies without such points are left out."""
    is_kept = (score >= _MIN_SCORE) & np.isfinite(keypoints_px).all(-1)
    seen = is_kept.any(1)
    is_kept = is_kept[seen]
    kept_px = np.where(is_kept[..., None], keypoints_px[seen], np.nan)
    low, high = (
        np.where(is_kept[..., None], kept_px, np.inf).min(1),
        np.where(is_kept[..., None], kept_px, -np.inf).max(1),
    )
    return ImageBodies(
        keypoints_px=read_only(kept_px),
        score=read_only(np.where(is_kept, score[seen], 0.0)),
        box_px=read_only(np.concatenate([low, high], axis=-1)),
        center_score=read_only(np.asarray(center_score[seen], np.float64)),
    )
