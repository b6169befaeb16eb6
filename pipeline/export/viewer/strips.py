"""Heat strips: how good each person is over time, in at most ``MAX_BUCKETS`` buckets of frames.

A bucket tells about its worst frame, so that a spot of a single frame is seen in a take of an hour.
"""

import base64
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Doubt, Source
from pipeline.export.viewer.frames import UNKNOWN_ERROR, PersonFrames, error_byte, share_byte

MAX_BUCKETS = 1024
COLUMNS = ("measured", "interpolated", "predicted", "error", "cameras", "identity")
"""Shares of joints by source (mean), reprojection error (largest), cameras and confidence in the identity (least)."""

_DOUBT_S = 0.5


def frames_a_bucket(num_frames: int) -> int:
    """Number of output frames that a bucket stands for."""
    return max(1, -(-num_frames // MAX_BUCKETS))


def identity_confidence(
    start_frame: int, num_frames: int, doubts: Sequence[Doubt], timebase: Timebase
) -> Float[np.ndarray, " frames"]:
    """Confidence in a person's identity: that of the worst doubt within half a second of a frame, else 1."""
    confidence = np.ones(num_frames)
    reach = round(_DOUBT_S * timebase.frame_rate_hz)
    for doubt in doubts:
        rows = slice(max(0, doubt.frame - reach - start_frame), max(0, doubt.frame + reach + 1 - start_frame))
        confidence[rows] = np.minimum(confidence[rows], doubt.confidence)
    return confidence


def encode_strips(person: PersonFrames, num_frames: int, num_body_joints: int) -> str:
    """Encode a person's strips: bytes of ``COLUMNS``, each a byte a bucket of the take, in base64.

    Shares and confidence are quantised by ``share_byte``, errors by ``error_byte``; cameras are counted. Outside of the
    person's frames everything is 0 and the error unknown. Joints of fingers, those after the first ``num_body_joints``,
    are left out.
    """
    return base64.b64encode(np.stack(_columns(person, num_frames, num_body_joints)).tobytes()).decode("ascii")


def _columns(person: PersonFrames, num_frames: int, num_body_joints: int) -> list[UInt8[np.ndarray, " buckets"]]:
    length, start = frames_a_bucket(num_frames), person.track.start_frame
    num_buckets = -(-num_frames // length)
    frames = start + np.arange(person.track.num_frames)
    # First row of each bucket that has frames of the person.
    buckets, rows = np.unique(frames // length, return_index=True)

    def spread(values: np.ndarray, empty: int = 0) -> UInt8[np.ndarray, " buckets"]:
        column = np.full(num_buckets, empty, np.uint8)
        column[buckets] = values
        return column

    source = person.track.source[:, :num_body_joints]
    sizes = np.diff([*rows, len(frames)])
    shares = [
        spread(share_byte(np.add.reduceat((source == kind).mean(1), rows) / sizes))
        for kind in (Source.MEASURED, Source.INTERPOLATED, Source.PREDICTED)
    ]
    is_seen = np.isfinite(person.camera_error_px)
    total_px = np.where(is_seen, person.camera_error_px, 0.0).sum(1)
    num_cameras = is_seen.sum(1)
    # NaN where no camera sees the person: fmax takes the other value.
    error_px = np.where(num_cameras > 0, total_px / np.maximum(num_cameras, 1), np.nan)
    return [
        *shares,
        spread(error_byte(np.fmax.reduceat(error_px, rows)), UNKNOWN_ERROR),
        spread(np.minimum.reduceat(num_cameras, rows)),
        spread(share_byte(np.minimum.reduceat(person.identity, rows))),
    ]
