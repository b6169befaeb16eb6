"""People who never move: posters, cut-outs and mannequins, and people who sleep.

Nobody stands still for long: the head sways by a centimetre, hands and feet move by several. Medians of half seconds of
what never moves differ by the noise of the detector alone.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.data.people import Track3D
from pipeline.core.joints import FINGER_JOINTS, JointSet

# Shortest time and fewest joints of which something is said.
_MIN_S, _MIN_JOINTS = 3.0, 8
_BLOCK_S = 0.5
# Blocks of a long take, evenly spread.
_MAX_BLOCKS = 600
# Share of the frames of a block, and of the blocks, in which a joint must be known.
_MIN_SHARE = 0.5
# Share of the blocks in which a joint must be near its usual place, and of the joints: bodies that pass in front are
# mixed up.
_BLOCKS, _JOINTS = 0.9, 0.9
# Largest movement of what never moves, beside the noise: so many standard deviations of a block's median, which errors
# of a detector that last for some time make larger.
_MAX_MOVED_M, _NUM_SIGMAS, _ERROR_LASTS_S = 0.015, 3.0, 0.1
# Noise in which no movement would be seen.
_MAX_NOISE_M = 0.04
# Way of half of the joints, in any block, after which somebody has moved.
_GONE_M = 0.2


@dataclass(frozen=True, slots=True)
class StillPerson:
    """Somebody, or something, that never moves."""

    number: int  # Position of the track
    # Distance of joints from their usual places that nine tenths of the take do not exceed; the largest of them
    moved_m: float
    num_frames: int  # Frames in which joints were located


def find_still(number: int, track: Track3D, joints: JointSet, frame_rate_hz: float) -> StillPerson | None:
    """Tell whether a person never moves; ``None`` for people who do, and where too little is known.

    ``number`` is the position of the track. Positions are those that association located, without smoothing.
    """
    body = [index for index, name in enumerate(joints.names) if name not in FINGER_JOINTS]
    rows = np.flatnonzero(np.isfinite(track.xyz_m[..., 0]).any(-1))
    block = max(2, round(_BLOCK_S * frame_rate_hz))  # noise is measured between neighbouring frames
    if len(rows) < max(_MIN_S * frame_rate_hz, block):
        return None
    blocks = rows[: len(rows) // block * block].reshape(-1, block)
    xyz_m = track.xyz_m[blocks[:: -(-len(blocks) // _MAX_BLOCKS)]][:, :, body]
    places_m = _medians(xyz_m)
    often = np.isfinite(places_m[..., 0]).mean(0) >= _MIN_SHARE
    if np.count_nonzero(often) < _MIN_JOINTS:
        return None
    places_m = places_m[:, often]
    away_m = np.linalg.norm(places_m - np.nanmedian(places_m, axis=0), axis=-1)
    moved_m = np.nanquantile(away_m, _BLOCKS, axis=0)
    num_errors = max(1.0, _BLOCK_S / max(_ERROR_LASTS_S, 1.0 / frame_rate_hz))
    noise_m = _NUM_SIGMAS * _sigma_m(xyz_m[:, :, often]) / np.sqrt(num_errors)
    is_still = (noise_m <= _MAX_NOISE_M) & (moved_m <= np.hypot(_MAX_MOVED_M, noise_m))
    if is_still.mean() < _JOINTS or _median_of_joints(away_m).max() > _GONE_M:
        return None
    return StillPerson(number, float(moved_m[is_still].max()), len(rows))


def _median_of_joints(away_m: Float[np.ndarray, "blocks joints"]) -> Float[np.ndarray, " blocks"]:
    """Median distance of the known joints of each block that has any."""
    return np.asarray(np.nanmedian(away_m[np.isfinite(away_m).any(-1)], axis=-1))


def _medians(blocks_m: Float[np.ndarray, "blocks frames joints 3"]) -> Float[np.ndarray, "blocks joints 3"]:
    """Median place of each joint in each block; NaN where it is known too seldom."""
    in_order_m = np.sort(blocks_m, axis=1)  # NaN comes last
    count = np.isfinite(blocks_m).sum(1, keepdims=True)
    middle_m = np.take_along_axis(in_order_m, np.maximum(count - 1, 0) // 2, axis=1)[:, 0]
    return np.where(count[:, 0] >= _MIN_SHARE * blocks_m.shape[1], middle_m, np.nan)


def _sigma_m(blocks_m: Float[np.ndarray, "blocks frames joints 3"]) -> Float[np.ndarray, " joints"]:
    """Standard deviation of each joint along its noisiest axis, from differences of neighbouring frames.

    Infinite for a joint that no two neighbouring frames know.
    """
    change_m = np.abs(np.diff(blocks_m, axis=1))
    change_m = change_m.reshape(-1, *change_m.shape[2:])
    sigma_m = np.full(change_m.shape[1], np.inf)
    known = np.isfinite(change_m).any((0, 2))
    sigma_m[known] = np.nanmedian(change_m[:, known], axis=0).max(-1) / 0.6745 / np.sqrt(2.0)
    return sigma_m
