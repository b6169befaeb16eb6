"""Record of a session's check: what the preflight found in the files, for the stages.

A NumPy archive without pickles, byte-identical for equal sessions.
"""

import functools
import hashlib
import io
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.points import PointSession
from pipeline.capture.preflight_record import LayoutRead
from pipeline.capture.session import CaptureSession, Session
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.laboratory import Laboratory, LaboratoryEvent, LaboratoryStart
from pipeline.core.data.own_points import OwnDetections, RigidShape
from pipeline.core.data.people import Track3D
from pipeline.core.data.rigid import Rigid3
from pipeline.core.findings import Finding
from pipeline.core.joints import JointSet
from pipeline.core.runtime.npz import decode_arrays, save_arrays
from pipeline.video.info import VideoInfo

DETECTION_ARRAYS = ("frame", "keypoints_px", "score", "box_px")
"""Arrays of ``Detections`` in archives."""
# Heads of the names of arrays of own points.
_OWN = ("own_", "scene_", "animal_")


def _cameras(cameras: Sequence[Camera]) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """Cameras as a part of the head, and as arrays, of an archive."""
    head = [{"name": camera.name, "size_px": camera.size_px, "lens": camera.lens} for camera in cameras]
    arrays: dict[str, np.ndarray] = {}
    for k, camera in enumerate(cameras):
        arrays |= {
            f"matrix_{k}": camera.matrix,
            f"distortion_{k}": camera.distortion,
            f"rotation_{k}": camera.cam_from_world.rotation,
            f"translation_m_{k}": camera.cam_from_world.translation_m,
        }
    return head, arrays


def _decode_cameras(head: Sequence[Mapping[str, Any]], arrays: Mapping[str, np.ndarray]) -> tuple[Camera, ...]:
    return tuple(
        Camera(
            name=camera["name"],
            size_px=tuple(camera["size_px"]),
            matrix=arrays[f"matrix_{k}"],
            distortion=arrays[f"distortion_{k}"],
            cam_from_world=Rigid3(arrays[f"rotation_{k}"], arrays[f"translation_m_{k}"]),
            lens=camera["lens"],
        )
        for k, camera in enumerate(head)
    )


def _laboratory(laboratory: Laboratory | None, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Entry of a head about a laboratory, none without one; its arrays join the others."""
    if laboratory is None:
        return {}
    arrays |= {"laboratory": laboratory.samples, "laboratory_pose": laboratory.world_from_laboratory.matrix}
    groups: dict[str, dict[str, list[str] | None]] = {}
    for group, parameters in laboratory.groups.items():
        numbers = {name: value for name, value in parameters.items() if isinstance(value, np.ndarray)}
        arrays |= {f"laboratory {group} {name}": value for name, value in numbers.items()}
        groups[group] = {name: value if isinstance(value, list) else None for name, value in parameters.items()}
    plain = ("file", "unit", "frame_rate_hz", "num_frames", "samples_per_frame", "events", "start")
    return {"laboratory": {name: getattr(laboratory, name) for name in plain} | {"groups": groups}}


def _decode_laboratory(head: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Laboratory | None:
    if (plain := head.get("laboratory")) is None:
        return None
    pose, start = arrays["laboratory_pose"], plain["start"]
    decoded = {
        "samples": arrays["laboratory"],
        "groups": {
            group: {
                name: arrays[f"laboratory {group} {name}"] if texts is None else texts
                for name, texts in parameters.items()
            }
            for group, parameters in plain["groups"].items()
        },
        "events": tuple(LaboratoryEvent(*event) for event in plain["events"]),
        "world_from_laboratory": Rigid3(pose[:, :3], pose[:, 3]),
        "start": None if start is None else LaboratoryStart(*start),
    }
    return Laboratory(**plain | decoded)


def save_record(session: Session, file: io.BufferedIOBase) -> None:
    """Write the record of a session of any kind into a file: in memory it would be as large as the session."""
    save_arrays(file, _arrays(session))


def record_sha256(session: Session) -> str:
    """SHA-256 of the record of a session."""
    with tempfile.TemporaryFile() as file:
        save_record(session, file)
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


@functools.singledispatch
def _arrays(session: Session) -> dict[str, np.ndarray]:
    raise TypeError(type(session).__name__)


@_arrays.register
def _of_videos(session: CaptureSession) -> dict[str, np.ndarray]:
    """Cameras and videos of a session; of the videos' paths only the names."""
    cameras, arrays = _cameras(session.cameras)
    head = {
        "cameras": cameras,
        "videos": [_video(video) for video in session.videos],
        "findings": [finding.to_json() for finding in session.findings],
        **({"offset_std_s": dict(session.offset_std_s)} if session.offset_std_s else {}),
        **_laboratory(session.laboratory, arrays),
    }
    arrays["head"] = np.array(json.dumps(head))
    for k, (camera, video) in enumerate(zip(session.cameras, session.videos, strict=True)):
        arrays |= {**_frames(video, str(k)), f"time_s_{k}": session.times[camera.name].time_s}
        for number, part in enumerate(video.parts):
            arrays |= _frames(part, f"{k}_{number}")
    return arrays


def _video(video: VideoInfo) -> dict[str, Any]:
    """Video as a part of the head of an archive."""
    return {
        "file": video.path.name,
        "codec": video.codec,
        "size_px": video.size_px,
        "rotation_deg": video.rotation_deg,
        "is_mirrored": video.is_mirrored,
        "frame_rate_hz": video.frame_rate_hz,
        "stored_width_px": video.stored_width_px,
        **({"parts": [_video(part) for part in video.parts]} if video.parts else {}),
    }


def _frames(video: VideoInfo, name: str) -> dict[str, np.ndarray]:
    """Frames of a video as arrays of an archive."""
    return {f"pts_{name}": video.pts, f"keyframe_pts_{name}": video.keyframe_pts, f"video_time_s_{name}": video.time_s}


def _decode_video(head: Mapping[str, Any], arrays: Mapping[str, np.ndarray], name: str, folder: Path) -> VideoInfo:
    return VideoInfo(
        path=folder / head["file"],
        codec=head["codec"],
        size_px=tuple(head["size_px"]),
        rotation_deg=head["rotation_deg"],
        is_mirrored=head["is_mirrored"],
        pts=arrays[f"pts_{name}"],
        keyframe_pts=arrays[f"keyframe_pts_{name}"],
        time_s=arrays[f"video_time_s_{name}"],
        frame_rate_hz=head["frame_rate_hz"],
        stored_width_px=head["stored_width_px"],
        parts=tuple(
            _decode_video(part, arrays, f"{name}_{number}", folder) for number, part in enumerate(head.get("parts", ()))
        ),
    )


def decode_session(content: bytes | BinaryIO, folder: Path) -> CaptureSession:
    """Read what ``save_record`` wrote; the videos are in ``folder`` by their names."""
    arrays = decode_arrays(content)
    head = json.loads(str(arrays["head"]))
    cameras = _decode_cameras(head["cameras"], arrays)
    return CaptureSession(
        cameras=cameras,
        videos=tuple(_decode_video(video, arrays, str(k), folder) for k, video in enumerate(head["videos"])),
        times={camera.name: FrameTimes(arrays[f"time_s_{k}"]) for k, camera in enumerate(cameras)},
        findings=tuple(map(Finding.from_json, head["findings"])),
        offset_std_s=head.get("offset_std_s", {}),
        laboratory=_decode_laboratory(head, arrays),
    )


@_arrays.register
def _of_keypoints(session: KeypointSession) -> dict[str, np.ndarray]:
    """All of a session of keypoints: its files are not needed again."""
    cameras, arrays = _cameras(session.cameras)
    head = {
        "cameras": cameras,
        "folders": dict(session.folders),
        "joints": asdict(session.joints),
        "timebase": asdict(session.timebase),
        "findings": [finding.to_json() for finding in session.findings],
        "layout": None if session.layout is None else asdict(session.layout),
        **({"own": session.own.names} if session.own.names else {}),
        **_own_file(session.own, arrays),
        **_laboratory(session.laboratory, arrays),
    }
    arrays["head"] = np.array(json.dumps(head))
    for k, camera in enumerate(session.cameras):
        found = session.detections[camera.name]
        arrays[f"time_s_{k}"] = session.times[camera.name].time_s
        arrays |= {f"{name}_{k}": getattr(found, name) for name in DETECTION_ARRAYS}
        if session.own.names:
            for kind, own in zip(_OWN, session.own.kinds, strict=True):
                arrays |= {f"{kind}{name}_{k}": getattr(own[camera.name], name) for name in DETECTION_ARRAYS}
    return arrays


def _own_file(own: OwnDetections, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Entry of a head about rigid objects and bones, none without them; places join the arrays."""
    arrays |= {f"shape_{k}": shape.xyz_m for k, shape in enumerate(own.shapes)}
    shapes = [[shape.name, shape.points, shape.has_sides] for shape in own.shapes]
    return {"own_file": {"shapes": shapes, "bones": own.bones}} if own.shapes or own.bones else {}


@_arrays.register
def _of_points(session: PointSession) -> dict[str, np.ndarray]:
    arrays = {
        f"{name}_{k}": array for k, track in enumerate(session.people) for name, array in track.joint_arrays.items()
    }
    head = {
        "joints": asdict(session.joints),
        "timebase": asdict(session.timebase),
        "starts": [track.start_frame for track in session.people],
        "findings": [finding.to_json() for finding in session.findings],
    }
    return {"head": np.array(json.dumps(head)), **arrays}


def decode_points(content: bytes | BinaryIO) -> PointSession:
    """Read what ``save_record`` wrote."""
    arrays = decode_arrays(content)
    head = json.loads(str(arrays["head"]))
    names = [each.name for each in fields(Track3D)]
    people = tuple(
        Track3D(k + 1, start, **{name: arrays[f"{name}_{k}"] for name in names if f"{name}_{k}" in arrays})
        for k, start in enumerate(head["starts"])
    )
    findings, timebase = tuple(map(Finding.from_json, head["findings"])), Timebase(**head["timebase"])
    return PointSession((), {}, timebase, {}, _joint_set(head["joints"]), {}, findings, people=people)


def _joint_set(head: Mapping[str, Any]) -> JointSet:
    return JointSet(tuple(head["names"]), tuple((first, second) for first, second in head["bones"]))


def decode_keypoints(content: bytes | BinaryIO) -> KeypointSession:
    """Read what ``save_record`` wrote."""
    arrays = decode_arrays(content)
    head = json.loads(str(arrays["head"]))
    cameras = _decode_cameras(head["cameras"], arrays)

    def detections(kind: str = "") -> dict[str, Detections]:
        return {
            camera.name: Detections(camera.name, *(arrays[f"{kind}{name}_{k}"] for name in DETECTION_ARRAYS))
            for k, camera in enumerate(cameras)
        }

    own, own_file = tuple(head.get("own", ())), head.get("own_file", {"shapes": (), "bones": ()})
    shapes = tuple(
        RigidShape(name, tuple(points), arrays[f"shape_{k}"], has_sides)
        for k, (name, points, has_sides) in enumerate(own_file["shapes"])
    )
    bones = tuple((first, second) for first, second in own_file["bones"])
    return KeypointSession(
        cameras=cameras,
        times={camera.name: FrameTimes(arrays[f"time_s_{k}"]) for k, camera in enumerate(cameras)},
        timebase=Timebase(**head["timebase"]),
        detections=detections(),
        own=OwnDetections(own, *map(detections, _OWN), shapes=shapes, bones=bones) if own else OwnDetections(),
        joints=_joint_set(head["joints"]),
        folders=head["folders"],
        findings=tuple(map(Finding.from_json, head["findings"])),
        layout=LayoutRead(**head["layout"]) if head.get("layout") else None,
        laboratory=_decode_laboratory(head, arrays),
    )
