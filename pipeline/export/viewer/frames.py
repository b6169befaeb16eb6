"""``motion.bin``: frames of all people as records of equal size, so that a range of frames is one range of bytes.

The records of a person follow each other without gaps, person after person. All numbers are little-endian.

======================  ===============  ===========================================================================
field                   type             meaning
======================  ===============  ===========================================================================
``origin_m``            3 x float32      position that the following ones are relative to, world coordinates
``joints``              joints x 3 int16 position of each joint in steps from the origin; -32768: absent
``skeleton``            bones x 3 int16  position of each joint of the animation skeleton, likewise
``forces``              4 x 3 int16      tail and tip of the left and the right foot's arrow, likewise; only with forces
``angles``              angles x int16   joint angles in steps of 0.1 degrees; -32768: unknown
``source_views``        joints x uint8   ``Source`` in the two low bits, number of cameras (at most 63) above them
``score``               joints x uint8   mean confidence of the observations, 255 for 1
``error``               joints x uint8   mean reprojection error in steps of 0.5 px, 254 for more; 255: unknown
``camera_error``        cameras x uint8  mean reprojection error of the body's joints in each camera, likewise
``identity``            uint8            confidence in the person's identity, 255 for 1
======================  ===============  ===========================================================================

Zeros fill the record up to a multiple of four bytes. The step is a person's own: 0.1 mm, or more for joints farther
than 3.2 m from the origin.
"""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Doubt, Source, Track3D
from pipeline.export.timelines import frame_blocks
from pipeline.motion.forces.person_forces import PersonForces

ABSENT = -32768
"""Coordinate of a joint without a position, and number of an angle that is unknown."""
UNKNOWN_ERROR = 255
ERROR_STEP_PX = 0.5
POSITION_STEP_M = 1e-4
ANGLE_STEP_DEG = 0.1
ARROW_M = 1.0
"""Length of the arrow of a force as large as the body's weight."""
Arrows = Mapping[int, Float[np.ndarray, "frames 4 3"]]
"""Arrows of the forces on people's feet (``force_arrows_m``), by the numbers of their tracks."""

_LARGEST = 32767
_MAX_VIEWS = 63
_ALIGNMENT = 4


@dataclass(frozen=True, slots=True, eq=False)
class PersonFrames:
    """Content of the records of one person."""

    track: Track3D  # Joints with final positions
    # Positions that the others are stored relative to: the skeleton's root
    root_m: Float[np.ndarray, "frames 3"]
    skeleton_m: Float[np.ndarray, "frames bones 3"]  # Positions of the joints of the animation skeleton
    # Joint angles of ``ANGLE_NAMES`` that the detector's joints can show; NaN where they are unknown
    angle_deg: Float[np.ndarray, "frames angles"]
    # Mean reprojection error of the body's joints in each camera, NaN where a camera sees nothing of the person
    camera_error_px: Float[np.ndarray, "frames cameras"]
    identity: Float[np.ndarray, " frames"]  # Confidence in the person's identity in [0, 1]
    arrows_m: Float[np.ndarray, "frames 4 3"]  # Arrows of the forces on the feet (``force_arrows_m``); NaN without


def record_type(
    num_joints: int, num_bones: int, num_angles: int, num_cameras: int, *, has_forces: bool = False
) -> np.dtype[np.void]:
    """Structure of a record; its fields are listed at the top of this module."""
    fields: list[tuple[str, str, tuple[int, ...]]] = [
        ("origin_m", "<f4", (3,)),
        ("joints", "<i2", (num_joints, 3)),
        ("skeleton", "<i2", (num_bones, 3)),
        *([("forces", "<i2", (4, 3))] if has_forces else []),
        ("angles", "<i2", (num_angles,)),
        ("source_views", "u1", (num_joints,)),
        ("score", "u1", (num_joints,)),
        ("error", "u1", (num_joints,)),
        ("camera_error", "u1", (num_cameras,)),
        ("identity", "u1", ()),
    ]
    used = np.dtype(fields).itemsize
    return np.dtype([*fields, ("padding", "u1", (-used % _ALIGNMENT,))])


def position_step_m(person: PersonFrames) -> float:
    """Step of a person's positions: as fine as 0.1 mm where 16 bits allow it."""
    stored_m = person.track.xyz_m, person.skeleton_m, person.arrows_m
    farthest_m = max(_farthest_m(xyz_m, person.root_m) for xyz_m in stored_m)
    # The origin is rounded to single precision, so a coordinate may end a little farther away.
    return float(max(POSITION_STEP_M, farthest_m * (1 + 1e-6) / _LARGEST))


def encode_person(person: PersonFrames, dtype: np.dtype[np.void]) -> Iterator[bytes]:
    """Encode the records of a person, block by block.

    ``dtype`` is the structure of the records. The person's skeleton may have fewer joints; the others are absent.
    """
    step_m = position_step_m(person)
    num_bones = person.skeleton_m.shape[1]
    track = person.track
    for rows in frame_blocks(track.num_frames):
        records = np.zeros(rows.stop - rows.start, dtype)
        records["origin_m"] = person.root_m[rows]
        origin_m = records["origin_m"][:, None].astype(float)
        records["joints"] = _steps(track.xyz_m[rows] - origin_m, step_m)
        records["skeleton"] = ABSENT
        records["skeleton"][:, :num_bones] = _steps(person.skeleton_m[rows] - origin_m, step_m)
        if "forces" in (dtype.names or ()):
            records["forces"] = _steps(person.arrows_m[rows] - origin_m, step_m)
        records["angles"] = _angle_steps(person.angle_deg[rows])
        records["source_views"] = track.source[rows] | np.minimum(track.views[rows], _MAX_VIEWS) << 2
        records["score"] = share_byte(track.score[rows])
        records["error"] = error_byte(track.error_px[rows])
        records["camera_error"] = error_byte(person.camera_error_px[rows])
        records["identity"] = share_byte(person.identity[rows])
        yield records.tobytes()


def encode_points(names: Sequence[str], person: int | None, points: Track3D) -> Iterator[dict[str, Any]]:
    """Describe points of the user's own that are known in any frame: positions in all frames of a track in base64."""
    for name, xyz_m in zip(names, points.xyz_m.swapaxes(0, 1), strict=True):
        known_m = xyz_m[np.isfinite(xyz_m).all(-1)]
        if not len(known_m):
            continue
        origin_m = np.round((known_m.min(0) + known_m.max(0)) / 2.0, 3)
        step_m = max(POSITION_STEP_M, float(np.abs(known_m - origin_m).max()) / _LARGEST)
        places = base64.b64encode(_steps(xyz_m - origin_m, step_m).astype("<i2").tobytes()).decode("ascii")
        yield {
            "name": name,
            "person": person,
            "start_frame": points.start_frame,
            "origin_m": origin_m.tolist(),
            "position_step_m": step_m,
            "positions": places,
        }


def force_arrows_m(forces: PersonForces) -> Float[np.ndarray, "frames 4 3"]:
    """Arrows of the forces on the feet: tail at the centre of pressure, and tip, of the left and of the right foot.

    World coordinates, NaN without contact. A force as large as the body's weight is ``ARROW_M`` long.
    """
    feet = forces.feet
    tip_m = feet.pressure_m + ARROW_M / forces.weight * feet.force
    ends_m = np.stack([feet.pressure_m, tip_m], axis=2)
    return np.where(feet.stands[..., None, None], ends_m, np.nan).reshape(-1, 4, 3)


def share_byte(share: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    """Quantise values in [0, 1]: 255 stands for 1."""
    return np.rint(255 * np.clip(share, 0.0, 1.0)).astype(np.uint8)


def error_byte(error_px: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    """Quantise errors in steps of ``ERROR_STEP_PX``; NaN becomes ``UNKNOWN_ERROR``."""
    steps = np.minimum(np.rint(error_px / ERROR_STEP_PX), UNKNOWN_ERROR - 1)
    return np.where(np.isnan(steps), UNKNOWN_ERROR, steps).astype(np.uint8)


def _angle_steps(angle_deg: Float[np.ndarray, "frames angles"]) -> np.ndarray:
    """Quantise angles; angles of many turns are brought within the range of the numbers by whole turns."""
    is_known = np.isfinite(angle_deg)
    known_deg = np.where(is_known, angle_deg, 0.0)
    most_deg = ANGLE_STEP_DEG * _LARGEST - 360.0
    whole_turns_deg = np.where(np.abs(known_deg) > most_deg, 360.0 * np.round(known_deg / 360.0), 0.0)
    return np.where(is_known, np.rint((known_deg - whole_turns_deg) / ANGLE_STEP_DEG), ABSENT).astype(np.int16)


def _steps(offset_m: Float[np.ndarray, "frames joints 3"], step_m: float) -> np.ndarray:
    is_known = np.isfinite(offset_m).all(-1, keepdims=True)
    return np.where(is_known, np.rint(np.where(is_known, offset_m, 0.0) / step_m), ABSENT).astype(np.int16)


def _farthest_m(xyz_m: Float[np.ndarray, "frames joints 3"], root_m: Float[np.ndarray, "frames 3"]) -> float:
    return max(
        (
            float(np.nanmax(np.abs(xyz_m[rows] - root_m[rows, None]), initial=0.0))
            for rows in frame_blocks(len(xyz_m))
            if np.isfinite(xyz_m[rows]).any()
        ),
        default=0.0,
    )


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
    """Confidence in a person's identity: the worst doubt within half a second of a frame, else 1."""
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
