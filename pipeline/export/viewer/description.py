"""``motion.json``: people, joints, cameras and strips; the index of ``motion.bin``.

Times of a camera's frames are few numbers: knots between which times are interpolated.
"""

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.capture.session import Session
from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.core.data.cameras import Camera, FrameTimes, Synchronization
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import without_hands
from pipeline.export.quality.views import PersonViews
from pipeline.export.scene import color_rgb
from pipeline.export.viewer import frames
from pipeline.motion.angles.compute import joint_angles, observable_angles
from pipeline.motion.balance.segment_masses import segment_masses
from pipeline.motion.body.joints import BODY_JOINTS, MIDDLE_TWIST_RAD, TWIST_JOINTS
from pipeline.motion.body.makehuman import FULL_WEIGHT, UNITS_PER_M
from pipeline.motion.body.shape import BodyShapes, shape_body, standing_ankle_m
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON, find_skeleton, forward_kinematics


def describe_body(shapes: BodyShapes) -> Mapping[str, Any]:
    """Describe what bodies of all people have in common. ``shapes`` are coarse."""
    return {
        "joints": BODY_JOINTS,
        "twists": [
            {"name": twist.name, "parent": twist.parent, "hand": twist.hand, "share": twist.share}
            for twist in TWIST_JOINTS
        ],
        "middle_twist_rad": MIDDLE_TWIST_RAD,
        "step_m": 1.0 / UNITS_PER_M,
        "triangles": _in_base64(shapes.triangles, "<u2"),
        "carriers": _in_base64(shapes.carriers, "u1"),
        "weights": _in_base64(np.rint(shapes.weights * FULL_WEIGHT), "u1"),
    }


def describe_shape(shapes: BodyShapes, motion: SkeletonMotion, floor: Floor | None) -> Mapping[str, str]:
    """Describe the shape of a person's body at rest: its vertices and joints."""
    shaped = shape_body(shapes, motion.bone_length_m, standing_ankle_m(motion, floor))
    return {
        "vertices": _in_base64(_in_steps(shaped.vertices_m), "<i2"),
        "joints": _in_base64(_in_steps(_with_fingers(shaped.joints_m)), "<i2"),
    }


def _with_fingers(joints_m: Float[np.ndarray, "joints 3"]) -> Float[np.ndarray, "all_joints 3"]:
    """Positions of all joints of bodies; joints of fingers that a skeleton has not are at the wrist."""
    num_joints = len(joints_m) - len(TWIST_JOINTS)
    wrists = [
        INDEX[f"{'Left' if joint.name.startswith('Left') else 'Right'}Hand"] for joint in WHOLE_SKELETON[num_joints:]
    ]
    return np.concatenate([joints_m[:num_joints], joints_m[wrists], joints_m[num_joints:]])


def _in_steps(positions_m: Float[np.ndarray, "positions 3"]) -> Float[np.ndarray, "positions 3"]:
    return np.rint(positions_m * UNITS_PER_M)


def _in_base64(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode("ascii")


SCHEMA_VERSION = 1
TOLERANCE_S = 1e-3
"""Largest difference of an interpolated time; videos of some containers are rounded to 1 ms anyway."""


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """Frames of a camera, and its video."""

    times: FrameTimes  # Times of the frames on the session's clock
    video: str | None = None  # Name of the video file; ``None`` for a session of keypoints
    video_times: FrameTimes | None = None  # Times of the frames since the start of the video; ``None`` without a video


def session_footage(session: Session) -> Mapping[str, Footage]:
    """Frames of each camera of a session, by the camera's name."""
    return {
        camera: Footage(times)
        if (video := session.camera_videos.get(camera)) is None
        else Footage(times, video.path.name, FrameTimes(video.time_s))
        for camera, times in session.times.items()
    }


class ViewerMotion:
    """Motion of a reconstruction for viewers.

    - ``reconstruction``: at the session's frame rate.
    - ``views``: its ``person_views``.
    - ``footage``: frames of each camera, by its name.
    - ``report``: content of ``metrics.json``.
    - ``first_frame``: number of the first frame before the take was cut; 0 if it was not.
    - ``shapes``: shapes of people's bodies, ``None`` if bodies are not installed.
    - ``arrows_m``: arrows of people who have forces.
    """

    def __init__(
        self,
        reconstruction: Reconstruction,
        views: Sequence[PersonViews],
        footage: Mapping[str, Footage],
        report: Mapping[str, Any],
        first_frame: int = 0,
        shapes: BodyShapes | None = None,
        arrows_m: frames.Arrows = MappingProxyType({}),
    ) -> None:
        self._take, self._views, self._footage = reconstruction, views, footage
        self._shapes = None if shapes is None else shapes.coarse()
        self._report, self._first_frame, self._arrows_m = report, first_frame, arrows_m
        num_bones = max((len(motion.bone_length_m) for motion in reconstruction.motions), default=0)
        self._skeleton = find_skeleton(num_bones) if num_bones else ()
        self._angle_names = observable_angles(reconstruction.joints)
        self.dtype = frames.record_type(
            len(reconstruction.joints.names),
            num_bones,
            len(self._angle_names),
            len(reconstruction.cameras),
            has_forces=bool(arrows_m),
        )
        self._steps_m: list[float] = []
        self._strips: list[str] = []

    def encode(self) -> Iterator[bytes]:
        """Encode ``motion.bin``, piece by piece."""
        self._steps_m, self._strips = [], []
        num_body_joints = len(without_hands(self._take.joints).names)
        for number in range(len(self._take.tracks)):
            person = person_frames(self._take, self._views, number, self._arrows_m)
            self._steps_m.append(frames.position_step_m(person))
            self._strips.append(frames.encode_strips(person, self._take.timebase.num_frames, num_body_joints))
            yield from frames.encode_person(person, self.dtype)

    def describe(self) -> bytes:
        """Encode ``motion.json`` as strict JSON. All pieces of ``encode`` must have been taken before."""
        take = self._take
        places = [joint.name for joint in self._skeleton]
        document = {
            "schema_version": SCHEMA_VERSION,
            "frame_rate_hz": take.timebase.frame_rate_hz,
            "start_time_s": take.timebase.start_time_s,
            "num_frames": take.timebase.num_frames,
            "first_frame": self._first_frame,
            "first_source_frame": take.timebase.first_source_frame,
            "joint_names": take.joints.names,
            "bones": take.joints.bones,
            "skeleton": {
                "names": places,
                "parents": [None if joint.parent is None else places.index(joint.parent) for joint in self._skeleton],
            },
            "angle_names": self._angle_names,
            "record": self._describe_record(),
            "people": list(self._describe_people()),
            **({"points": points} if (points := list(self._describe_points())) else {}),
            **({"point_bones": bones} if (bones := list(self._describe_bones(points))) else {}),
            "body": None if self._shapes is None else describe_body(self._shapes),
            "cameras": [_describe_camera(camera, self._footage.get(camera.name)) for camera in take.cameras],
            "clocks": None if take.synchronization is None else list(_describe_clocks(take.synchronization)),
            "is_refined": take.refinement is not None and take.refinement.refined,
            "floor": None
            if take.animation.floor is None
            else {
                "height_m": take.animation.floor.z_m,
                "slope_x": take.animation.floor.slope_x,
                "slope_y": take.animation.floor.slope_y,
            },
            "reprojection_error_px": self._report["reprojection_error_px"],
            "warnings": [
                *(finding.to_json() for finding in take.warnings),
                *self._report["capture_checks"],
                *self._report["world_checks"],
            ],
            "concerns": self._report["concerns"],
            "strips": {
                "frames_per_bucket": frames.frames_a_bucket(take.timebase.num_frames),
                "columns": frames.COLUMNS,
                "people": self._strips,
            },
        }
        return _encoded(document)

    def _describe_record(self) -> dict[str, Any]:
        fields: Mapping[str, tuple[Any, ...]] = self.dtype.fields or {}
        return {
            "num_bytes": self.dtype.itemsize,
            "offsets": {name: fields[name][1] for name in self.dtype.names or () if name != "padding"},
            "absent": frames.ABSENT,
            "angle_step_deg": frames.ANGLE_STEP_DEG,
            "error_step_px": frames.ERROR_STEP_PX,
            "unknown_error": frames.UNKNOWN_ERROR,
        }

    def _describe_people(self) -> Iterator[dict[str, Any]]:
        offset_bytes, floor = 0, self._take.animation.floor
        figures = {person["id"]: person for person in self._report["people"]}
        for track, motion, step_m in zip(self._take.tracks, self._take.motions, self._steps_m, strict=True):
            red, green, blue = color_rgb(track.track_id)
            of_person = figures[track.track_id]
            masses = segment_masses(self._take.subject_of(track.track_id), self._take.joints, track.xyz_m)
            yield {
                "id": track.track_id,
                "name": motion.name,
                "color": f"#{red:02x}{green:02x}{blue:02x}",
                "start_frame": track.start_frame,
                "num_frames": track.num_frames,
                "offset_bytes": offset_bytes,
                "position_step_m": step_m,
                "coverage": of_person["coverage"],
                "stature_m": of_person["stature_m"],
                "reprojection_error_px": of_person["reprojection_error_px"],
                "identity": of_person["identity"],
                # Rows of four numbers: a long take has thousands of contacts.
                "contacts": [
                    [
                        ("left", "right").index(contact.side),
                        ("foot", "heel", "toe").index(contact.part),
                        track.start_frame + contact.start_frame,
                        contact.num_frames,
                    ]
                    for contact in motion.contacts
                ],
                # Weights of the joints in the centre of mass, without offsets of segments' centres from their lines.
                "mass_weights": None if masses is None else masses.weights.round(5).tolist(),
                "gait": of_person["gait"],
                "movements": of_person["movements"],
                "body": None if self._shapes is None else describe_shape(self._shapes, motion, floor),
            }
            offset_bytes += track.num_frames * self.dtype.itemsize

    def _describe_points(self) -> Iterator[dict[str, Any]]:
        """Points of the user's own: of people, then of objects."""
        own = self._take.own
        for number, track in enumerate(self._take.tracks):
            if (points := own.of_person(number)) is not None:
                yield from frames.encode_points(own.names, track.track_id, points)
        if own.scene is not None:
            yield from frames.encode_points(own.scene[0].names, None, own.scene[1])

    def _describe_bones(self, points: Sequence[Mapping[str, Any]]) -> Iterator[list[int]]:
        """Pairs of places among described points between which bones are."""
        own = self._take.own
        place_of = {(point["person"], point["name"]): place for place, point in enumerate(points)}
        owned = [(track.track_id, bone) for track in self._take.tracks for bone in own.bones]
        for person, ends in owned + [(None, bone) for bone in (own.scene[0].bones if own.scene else ())]:
            places = [place_of[person, end] for end in ends if (person, end) in place_of]
            if len(places) == len(ends):
                yield places


def with_names(description: bytes, motions: Sequence[SkeletonMotion]) -> bytes:
    """``motion.json`` of the same people with the names of ``motions``, in the same order."""
    document = json.loads(description)
    for person, motion in zip(document["people"], motions, strict=True):
        person["name"] = motion.name
    return _encoded(document)


def _encoded(document: Mapping[str, Any]) -> bytes:
    return (json.dumps(document, allow_nan=False, separators=(",", ":")) + "\n").encode("ascii")


def person_frames(
    reconstruction: Reconstruction,
    views: Sequence[PersonViews],
    number: int,
    arrows_m: frames.Arrows = MappingProxyType({}),
) -> frames.PersonFrames:
    """Content of the records of the person with a number on the list of tracks."""
    track, motion = reconstruction.tracks[number], reconstruction.motions[number]
    doubts: Sequence[Any] = reconstruction.doubts[number] if reconstruction.doubts else ()
    joints = reconstruction.joints
    shown = np.isin(ANGLE_NAMES, observable_angles(joints))
    return frames.PersonFrames(
        track,
        motion.root_m,
        forward_kinematics(motion),
        joint_angles(motion, track, joints, has_sigmas=False).angle_deg[:, shown],
        mean_of_known(views[number].error_px[:, :, : len(without_hands(joints).names)]),
        frames.identity_confidence(track.start_frame, track.num_frames, doubts, reconstruction.timebase),
        arrows_m.get(track.track_id, np.full((track.num_frames, 4, 3), np.nan)),
    )


def mean_of_known(error_px: np.ndarray) -> np.ndarray:
    """Mean over the last axis of the values that are not NaN; NaN without any."""
    is_known = np.isfinite(error_px)
    num_known = is_known.sum(-1)
    total_px = np.where(is_known, error_px, 0.0).sum(-1)
    return np.where(num_known > 0, total_px / np.maximum(num_known, 1), np.nan)


def _describe_camera(camera: Camera, footage: Footage | None) -> dict[str, Any]:
    return {
        "name": camera.name,
        "size_px": list(camera.size_px),
        "matrix": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
        "lens": camera.lens,
        "cam_from_world": {
            "rotation": camera.cam_from_world.rotation.tolist(),
            "translation_m": camera.cam_from_world.translation_m.tolist(),
        },
        "video": None if footage is None else footage.video,
        "clock": [] if footage is None else _describe_clock(footage),
    }


def _describe_clocks(synchronization: Synchronization) -> Iterator[dict[str, Any]]:
    """Measured clocks with the evidence for them; a standard deviation that is not finite is ``None``."""
    for clock, evidence in zip(synchronization.clocks, synchronization.evidence, strict=True):
        yield {
            "camera": clock.camera,
            "offset_s": round(clock.offset_s, 6),
            "sigma_s": round(clock.sigma_s, 6) if isfinite(clock.sigma_s) else None,
            "rate": round(clock.rate, 9),
            "offsets_s": [round(value_s, 4) for value_s in evidence.offsets_s],
            "disagreement": [round(share, 4) for share in evidence.disagreement],
        }


def _describe_clock(footage: Footage) -> list[list[int | float]]:
    """Rows of frame number, time on the session's clock and, with a video, time in the video."""
    clocks = [footage.times] if footage.video_times is None else [footage.times, footage.video_times]
    times_s = np.stack([clock.time_s for clock in clocks], axis=1)
    if not len(times_s):
        return []
    return [[frame, *(round(float(time_s), 6) for time_s in times_s[frame])] for frame in knots(times_s)]


def knots(times_s: Float[np.ndarray, "frames clocks"]) -> list[int]:
    """Frames between which the times of all others are interpolated linearly, within ``TOLERANCE_S``.

    A steady camera has two knots. Each pause and each change of the rate adds some (Douglas and Peucker 1973). Times
    ascend, on one clock or several, at least one frame. Numbers of frames ascend, with the first and the last one.
    """
    found = {0, len(times_s) - 1}
    open_parts = [(0, len(times_s) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        share = (np.arange(first, last + 1) - first)[:, None] / max(1, last - first)
        straight_s = times_s[first] + share * (times_s[last] - times_s[first])
        off_s = np.abs(times_s[first : last + 1] - straight_s).max(1)
        worst = first + int(off_s.argmax())
        if off_s[worst - first] > TOLERANCE_S:
            found.add(worst)
            open_parts += [(first, worst), (worst, last)]
    return sorted(found)
