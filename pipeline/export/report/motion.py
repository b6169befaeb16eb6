"""Motion and quality of a take for the script of the report: few bytes, thinned out if the take is long."""

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Camera
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import without_hands
from pipeline.export.colors import color_rgb
from pipeline.export.quality.views import PersonViews
from pipeline.export.viewer.bodies import describe_body, describe_shape
from pipeline.export.viewer.description import person_frames
from pipeline.export.viewer.frames import ERROR_STEP_PX, UNKNOWN_ERROR, PersonFrames
from pipeline.export.viewer.strips import COLUMNS, encode_strips, frames_a_bucket
from pipeline.motion.body.shape import BodyShapes
from pipeline.motion.skeleton.model import SkeletonJoint, parents_of, skeleton_of

ABSENT = -32768
"""Coordinate of a joint without a position."""

MAX_MOTION_BYTES = 4 * 2**20
"""Largest size of the motion in 3D; of a longer take each n-th frame is kept."""

_LARGEST, _LARGEST_TURN = 32767, 127
_BYTES_OF_POSITION, _BYTES_OF_TURN = 6, 4
_STEP_M = 1e-3
# Radius of the limb that ends at a joint, in metres, by the end of the joint's name.
_RADII = (
    (r"Hand(Thumb|Index|Middle|Ring|Pinky)", 0.009),
    (r"HeadEnd$", 0.085),
    (r"Head$", 0.05),
    (r"(Spine|Chest)$", 0.1),
    (r"Neck$", 0.055),
    (r"(Hand|HandEnd)$", 0.03),
    (r"Arm$", 0.045),
    (r"UpLeg$", 0.07),
    (r"Leg$", 0.065),
    (r"(Foot|FootEnd)$", 0.04),
)
_USUAL_RADIUS_M = 0.04


@dataclass(frozen=True, slots=True, eq=False)
class ReportMotion:
    """Motion and quality of a take."""

    document: dict[str, Any]  # JSON document for the script of the report
    stride: int  # Number of output frames from one frame of the motion in 3D to the next
    num_people: Int[np.ndarray, " frames"]  # Number of people in each output frame
    # Mean reprojection error of the worst person in each output frame; NaN where no camera sees anybody
    error_px: Float[np.ndarray, " frames"]


def motion_of(
    take: Reconstruction,
    views: Sequence[PersonViews],
    max_bytes: int = MAX_MOTION_BYTES,
    shapes: BodyShapes | None = None,
) -> ReportMotion:
    """Prepare motion and quality of a take for the report; people have human bodies if there are ``shapes``."""
    coarse = None if shapes is None else shapes.coarse()
    num_bones = max((len(motion.bone_length_m) for motion in take.motions), default=0)
    skeleton = skeleton_of(num_bones) if num_bones else ()
    num_frames = take.timebase.num_frames
    record_bytes = (_BYTES_OF_POSITION + (0 if coarse is None else _BYTES_OF_TURN)) * num_bones
    stride = stride_for([track.num_frames for track in take.tracks], record_bytes, max_bytes)
    num_people, error_px = np.zeros(num_frames, int), np.full(num_frames, np.nan)
    num_body_joints = len(without_hands(take.joints).names)
    people, strips, positions_m = [], [], []
    for number, track in enumerate(take.tracks):
        person = person_frames(take, views, number)
        rows = slice(track.start_frame, track.start_frame + track.num_frames)
        num_people[rows] += 1
        error_px[rows] = np.fmax(error_px[rows], _mean_error_px(person))
        strips.append(encode_strips(person, num_frames, num_body_joints))
        first = -(-track.start_frame // stride)
        kept_m = person.skeleton_m[first * stride - track.start_frame :: stride]
        positions_m.append(np.pad(kept_m, ((0, 0), (0, num_bones - kept_m.shape[1]), (0, 0)), constant_values=np.nan))
        red, green, blue = color_rgb(track.track_id)
        motion = take.motions[number]
        people.append(
            {
                "body": None
                if coarse is None
                else {
                    **describe_shape(coarse, motion, take.animation.floor),
                    "turns": encode_turns(
                        motion, range(first * stride - track.start_frame, track.num_frames, stride), num_bones
                    ),
                },
                "name": motion.name,
                "color": f"#{red:02x}{green:02x}{blue:02x}",
                "start": first,
                "count": len(kept_m),
                "start_frame": track.start_frame,
                "num_frames": track.num_frames,
            }
        )
    step_m, origin_m, content = encode_positions(positions_m)
    floor = take.animation.floor
    document = {
        "num_frames": num_frames,
        "frame_rate_hz": take.timebase.frame_rate_hz,
        "start_time_s": take.timebase.start_time_s,
        "first_source_frame": take.timebase.first_source_frame,
        "stride": stride,
        "step_m": step_m,
        "origin_m": origin_m,
        "absent": ABSENT,
        "num_joints": num_bones,
        "bones": _bones(skeleton),
        "top": next((number for number, joint in enumerate(skeleton) if joint.name == "HeadEnd"), 0),
        "body": None if coarse is None else describe_body(coarse),
        "people": people,
        "positions": base64.b64encode(content).decode("ascii"),
        "cameras": [_describe_camera(camera) for camera in take.cameras],
        "floor": [0.0, 0.0, 0.0] if floor is None else [floor.z_m, floor.slope_x, floor.slope_y],
        "strips": {
            "frames_per_bucket": frames_a_bucket(num_frames),
            "columns": COLUMNS,
            "error_step_px": ERROR_STEP_PX,
            "unknown_error": UNKNOWN_ERROR,
            "people": strips,
        },
    }
    return ReportMotion(document, stride, num_people, error_px)


def stride_for(num_frames: Sequence[int], record_bytes: int, max_bytes: int) -> int:
    """Smallest stride with which the records of all people are at most as large as wanted, or of one frame each.

    >>> stride_for([300, 300], 100, 20_000)
    3
    """
    stride = 1
    while any(num > stride for num in num_frames) and sum(-(-num // stride) for num in num_frames) > max(
        1, max_bytes // max(1, record_bytes)
    ):
        stride += max(1, stride // 8)
    return stride


def encode_positions(
    people_m: Sequence[Float[np.ndarray, "_ joints 3"]],
) -> tuple[float, list[float], bytes]:
    """Encode positions as little-endian integers of 16 bits: steps from an origin; ``ABSENT`` for NaN.

    Returns the size of a step, the origin, both in metres, and the bytes of all people, one after the other.
    """
    known = [people[np.isfinite(people).all(-1)] for people in people_m]
    everything_m = np.concatenate([*known, np.zeros((0, 3))])
    if not len(everything_m):
        return (
            _STEP_M,
            [0.0, 0.0, 0.0],
            b"".join(np.full(person_m.shape, ABSENT, "<i2").tobytes() for person_m in people_m),
        )
    origin_m = np.round((everything_m.min(0) + everything_m.max(0)) / 2, 3)
    step_m = max(_STEP_M, float(np.abs(everything_m - origin_m).max()) / _LARGEST)
    content = b"".join(
        np.where(
            np.isfinite(person_m).all(-1, keepdims=True), np.rint((np.nan_to_num(person_m) - origin_m) / step_m), ABSENT
        )
        .astype("<i2")
        .tobytes()
        for person_m in people_m
    )
    return step_m, origin_m.tolist(), content


def encode_turns(motion: SkeletonMotion, rows: range, num_joints: int) -> str:
    """Encode orientations of joints in frames of a motion: quaternions (x, y, z, w) in steps of 1/127, in base64.

    Joints that the motion has not have the quaternion 0.
    """
    quat = np.zeros((len(rows), num_joints, 4))
    world: list[Rotation] = []
    for joint, parent in enumerate(parents_of(len(motion.bone_length_m)) if len(rows) else ()):
        own = Rotation.from_quat(motion.parent_from_joint[rows.start :: rows.step, joint])
        world.append(world[parent] * own if joint else own)
        quat[:, joint] = world[joint].as_quat()
    return base64.b64encode(np.rint(quat * _LARGEST_TURN).astype("i1").tobytes()).decode("ascii")


def _mean_error_px(person: PersonFrames) -> Float[np.ndarray, " frames"]:
    is_seen = np.isfinite(person.camera_error_px)
    total_px = np.where(is_seen, person.camera_error_px, 0.0).sum(1)
    return np.where(is_seen.any(1), total_px / np.maximum(is_seen.sum(1), 1), np.nan)


def _bones(skeleton: Sequence[SkeletonJoint]) -> list[tuple[int, int, float]]:
    """Bones as start, end and radius. Collar bones are left out: they start inside the chest."""
    names = [joint.name for joint in skeleton]
    return [
        (names.index(joint.parent), number, _radius_m(joint.name))
        for number, joint in enumerate(skeleton)
        if joint.parent is not None and joint.kind != "Shoulder"
    ]


def _radius_m(name: str) -> float:
    return next((radius_m for end, radius_m in _RADII if re.search(end, name)), _USUAL_RADIUS_M)


def _describe_camera(camera: Camera) -> dict[str, Any]:
    return {
        "name": camera.name,
        "size_px": list(camera.size_px),
        "matrix": camera.matrix.tolist(),
        "rotation": camera.cam_from_world.rotation.tolist(),
        "translation_m": camera.cam_from_world.translation_m.tolist(),
    }
