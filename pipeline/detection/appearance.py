"""Colours of detected bodies: histograms of the clothes on torso and legs.

Pixels are taken at a fixed number of places in each part, so that the cost depends neither on the size of the image
nor on the body's. Bins of hue and saturation change little with the light; clothes without a hue, black, grey
and white, have bins of brightness. A pixel is shared among the bins around its colour, so that a small change of the
light changes a histogram little.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from pipeline.core.data.arrays import read_only
from pipeline.core.joints import JointSet

PARTS = ("torso", "legs")
_NUM_HUES, _NUM_GREYS = 12, 8
NUM_BINS = 2 * _NUM_HUES + _NUM_GREYS
"""Bins of pale and of strong colours by hue, then bins of grey from black to white."""

# Least score of the joints of a part.
_MIN_SCORE = 0.2
# A shorter part has so few pixels that many of them show the background as well.
_MIN_LENGTH_PX = 8.0
# Width of the band along a bone of the leg, as a share of the bone's length: narrower than a leg.
_BAND_WIDTH = 0.16

_TORSO = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
_LEGS = (("left_hip", "left_knee", "left_ankle"), ("right_hip", "right_knee", "right_ankle"))

# Places across and along a part, as shares of its width and length. They keep away from its ends, where skin, hair and
# other clothes begin.
_TORSO_ACROSS, _TORSO_ALONG = np.meshgrid(np.linspace(0.15, 0.85, 12), np.linspace(0.1, 0.85, 20))
_BAND_ACROSS, _BAND_ALONG = np.meshgrid(_BAND_WIDTH * np.linspace(-0.5, 0.5, 4), np.linspace(0.2, 0.85, 10))
_PART_OF_PLACE = np.repeat([0, 1], [_TORSO_ACROSS.size, 2 * len(_LEGS) * _BAND_ACROSS.size])


def colour_histograms(
    image_rgb: UInt8[np.ndarray, "height width 3"],
    keypoints_px: Float[np.ndarray, "n joints 2"],
    score: Float[np.ndarray, "n joints"],
    joints: JointSet,
) -> UInt8[np.ndarray, "n parts bins"]:
    """Measure the colours of the bodies in an image.

    The torso is the quadrilateral of shoulders and hips; the legs are bands from hip to knee and from knee to ankle.

    ``keypoints_px``, ``score``: joints of the bodies in pixels of the image, NaN where a joint was not found, and their
    scores. Returns histogram of each of ``PARTS``, with a sum of about 255. Zeros for a part with a joint that is
    missing, outside the image or low in score; legs are known if one of them is.
    """
    keypoints_px = keypoints_px.astype(np.float64)  # as they are stored: a second measurement gives the same bytes
    num_bodies = len(keypoints_px)
    height, width = image_rgb.shape[:2]
    is_inside = ((keypoints_px >= 0) & (keypoints_px <= (width - 1, height - 1))).all(-1) & (score >= _MIN_SCORE)
    corners = joints.indices(_TORSO)
    parts = [
        _torso(keypoints_px[:, corners], is_inside[:, corners]),
        *(_leg(keypoints_px[:, leg], is_inside[:, leg]) for leg in map(joints.indices, _LEGS)),
    ]
    places_px = np.concatenate([places for places, _ in parts], axis=1)
    is_known = np.concatenate([known for _, known in parts], axis=1)
    bodies, places = np.nonzero(is_known)
    columns, rows = np.rint(places_px[bodies, places]).astype(np.int64).T
    bins, shares = _colour_bins(image_rgb[rows.clip(0, height - 1), columns.clip(0, width - 1)])
    cells = (bodies * len(PARTS) + _PART_OF_PLACE[places]) * NUM_BINS + bins
    weight = np.bincount(cells.ravel(), shares.ravel(), num_bodies * len(PARTS) * NUM_BINS)
    histograms = weight.reshape(num_bodies, len(PARTS), NUM_BINS)
    total = histograms.sum(-1, keepdims=True)
    return read_only(np.rint(255 * histograms / np.where(total > 0, total, 1.0)).astype(np.uint8))


def _torso(
    corners_px: Float[np.ndarray, "n 4 2"], is_inside: Bool[np.ndarray, "n 4"]
) -> tuple[Float[np.ndarray, "n places 2"], Bool[np.ndarray, "n places"]]:
    """Places in the quadrilateral of both shoulders and both hips, and whether they are known."""
    across, along = _TORSO_ACROSS.ravel()[:, None], _TORSO_ALONG.ravel()[:, None]
    left_shoulder, right_shoulder, left_hip, right_hip = (corners_px[:, None, k] for k in range(4))
    places_px = (1 - along) * ((1 - across) * left_shoulder + across * right_shoulder) + along * (
        (1 - across) * left_hip + across * right_hip
    )
    length_px = np.linalg.norm(corners_px[:, 2:].mean(1) - corners_px[:, :2].mean(1), axis=-1)
    is_known = is_inside.all(-1) & (length_px >= _MIN_LENGTH_PX)
    return places_px, np.repeat(is_known[:, None], across.size, axis=1)


def _leg(
    joints_px: Float[np.ndarray, "n 3 2"], is_inside: Bool[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n places 2"], Bool[np.ndarray, "n places"]]:
    """Places in the bands from hip to knee and from knee to ankle, and whether they are known."""
    across, along = _BAND_ACROSS.ravel()[:, None], _BAND_ALONG.ravel()[:, None]
    bones_px = np.diff(joints_px, axis=1)[:, :, None]
    normals_px = np.stack([-bones_px[..., 1], bones_px[..., 0]], axis=-1)
    places_px = joints_px[:, :2, None] + along * bones_px + across * normals_px
    is_known = is_inside.all(-1) & (np.linalg.norm(bones_px, axis=-1) >= _MIN_LENGTH_PX).all((1, 2))
    num_places = 2 * across.size
    return places_px.reshape(-1, num_places, 2), np.repeat(is_known[:, None], num_places, axis=1)


def _colour_bins(
    pixels_rgb: UInt8[np.ndarray, "pixels 3"],
) -> tuple[Int[np.ndarray, "shared pixels"], Float32[np.ndarray, "shared pixels"]]:
    """Bins that share each pixel, and their shares; these sum to 1."""
    if len(pixels_rgb) == 0:  # OpenCV takes no empty image
        return np.empty((6, 0), np.int64), np.empty((6, 0), np.float32)
    hsv = cv2.cvtColor(pixels_rgb[None], cv2.COLOR_RGB2HSV_FULL)[0].astype(np.float32)
    hue, saturation, value = hsv[:, 0] / 256, hsv[:, 1] / 255, hsv[:, 2] / 255
    # Of a dark or a grey pixel the hue is noise.
    coloured = np.clip((saturation - 0.1) / 0.15, 0, 1) * np.clip((saturation * value - 0.04) / 0.08, 0, 1)
    strong = np.clip((saturation - 0.35) / 0.3, 0, 1)
    first_hue, to_next_hue = _divided(hue * _NUM_HUES)
    next_hue = (first_hue + 1) % _NUM_HUES
    first_grey, to_next_grey = _divided(value * (_NUM_GREYS - 1))
    next_grey = np.minimum(first_grey + 1, _NUM_GREYS - 1)
    bins = [
        first_hue,
        next_hue,
        _NUM_HUES + first_hue,
        _NUM_HUES + next_hue,
        2 * _NUM_HUES + first_grey,
        2 * _NUM_HUES + next_grey,
    ]
    pale, strong = coloured * (1 - strong), coloured * strong
    shares = [
        pale * (1 - to_next_hue),
        pale * to_next_hue,
        strong * (1 - to_next_hue),
        strong * to_next_hue,
        (1 - coloured) * (1 - to_next_grey),
        (1 - coloured) * to_next_grey,
    ]
    return np.array(bins), np.array(shares)


def _divided(positions: Float32[np.ndarray, " n"]) -> tuple[Int[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
    """Whole and fractional parts."""
    whole = np.floor(positions)
    return whole.astype(np.int64), positions - whole
