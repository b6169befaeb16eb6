"""Records as files between stages: NumPy archives, byte-identical for equal records.

Only plain arrays are written and read (no pickles): a file that was tampered with can't run code.
"""

import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
from jaxtyping import Int
from numpy.lib.npyio import NpzFile

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession
from pipeline.clustering.bone_lengths import LimbLengths
from pipeline.data import (
    Animation,
    Camera,
    DamagedVideo,
    Detections,
    Floor,
    FootContact,
    FrameTimes,
    MapGrid,
    Observations,
    PafFields,
    People,
    Poses3D,
    SkeletonMotion,
    Timebase,
    Track3D,
    no_frames,
)
from pipeline.geometry.rigid import Rigid3
from pipeline.joints import JointSet
from pipeline.video.info import VideoInfo

_FIELD_ARRAYS = ("frame", "peak_row", "peak_joint", "peak_px", "peak_score", "fields", "limbs")
_POSE_ARRAYS = ("frame", "xyz_m", "points_px", "score", "approximate")
_TRACK_ARRAYS = ("xyz_m", "score", "source", "error_px", "views")
_CONTACT = np.dtype(
    [
        ("side", "U5"),
        ("start_frame", np.int64),
        ("num_frames", np.int64),
        ("confidence", np.float64),
        ("pinned", np.bool_),
        ("slide_before_m", np.float64),
        ("slide_after_m", np.float64),
    ]
)
_DAMAGED_VIDEOS = "damaged_videos"
_Record = TypeVar("_Record")
_DETECTION_ARRAYS = ("frame", "keypoints_px", "score", "box_px")


def _save(file: io.BufferedIOBase, arrays: Mapping[str, np.ndarray]) -> None:
    np.savez_compressed(file, allow_pickle=False, **arrays)


def _encode(arrays: Mapping[str, np.ndarray]) -> bytes:
    file = io.BytesIO()
    _save(file, arrays)
    return file.getvalue()


def _decode(content: bytes) -> dict[str, np.ndarray]:
    with _open(content) as archive:
        return dict(archive)


def _open(content: bytes | Path) -> NpzFile:
    """Open an archive, or the file that holds it: its arrays are read when they are asked for."""
    opened: NpzFile = np.load(content if isinstance(content, Path) else io.BytesIO(content), allow_pickle=False)
    return opened


class _Stored(Sequence[_Record]):
    """Records in a file, each read anew whenever it is asked for: all of a long session's are large.

    Parameters
    ----------
    num_records
        How many there are.
    read
        Reads the one with a number.
    """

    def __init__(self, num_records: int, read: Callable[[int], _Record]) -> None:
        self._numbers, self._read = range(num_records), read

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> _Record: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[_Record]: ...

    def __getitem__(self, index: int | slice) -> _Record | Sequence[_Record]:
        numbers = self._numbers[index]
        return self._read(numbers) if isinstance(numbers, int) else [self._read(number) for number in numbers]


def _cameras(cameras: Sequence[Camera]) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """What the head and the arrays of an archive say of cameras."""
    head = [{"name": camera.name, "size_px": camera.size_px} for camera in cameras]
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
            name=one["name"],
            size_px=tuple(one["size_px"]),
            matrix=arrays[f"matrix_{k}"],
            distortion=arrays[f"distortion_{k}"],
            cam_from_world=Rigid3(arrays[f"rotation_{k}"], arrays[f"translation_m_{k}"]),
        )
        for k, one in enumerate(head)
    )


def encode_session(session: CaptureSession) -> bytes:
    """Write what is known of a session's cameras and videos; of the videos' paths only the names."""
    cameras, arrays = _cameras(session.cameras)
    head = {
        "cameras": cameras,
        "videos": [
            {
                "file": video.path.name,
                "codec": video.codec,
                "size_px": video.size_px,
                "rotation_deg": video.rotation_deg,
                "frame_rate_hz": video.frame_rate_hz,
            }
            for video in session.videos
        ],
        "warnings": session.warnings,
    }
    arrays["head"] = np.array(json.dumps(head))
    for k, (camera, video) in enumerate(zip(session.cameras, session.videos, strict=True)):
        arrays |= {
            f"pts_{k}": video.pts,
            f"keyframe_pts_{k}": video.keyframe_pts,
            f"video_time_s_{k}": video.time_s,
            f"time_s_{k}": session.times[camera.name].time_s,
        }
    return _encode(arrays)


def decode_session(content: bytes, folder: Path) -> CaptureSession:
    """Read what ``encode_session`` wrote; the videos are in ``folder`` by their names."""
    arrays = _decode(content)
    head = json.loads(str(arrays["head"]))
    cameras = _decode_cameras(head["cameras"], arrays)
    return CaptureSession(
        cameras=cameras,
        videos=tuple(
            VideoInfo(
                path=folder / one["file"],
                codec=one["codec"],
                size_px=tuple(one["size_px"]),
                rotation_deg=one["rotation_deg"],
                pts=arrays[f"pts_{k}"],
                keyframe_pts=arrays[f"keyframe_pts_{k}"],
                time_s=arrays[f"video_time_s_{k}"],
                frame_rate_hz=one["frame_rate_hz"],
            )
            for k, one in enumerate(head["videos"])
        ),
        times={camera.name: FrameTimes(arrays[f"time_s_{k}"]) for k, camera in enumerate(cameras)},
        warnings=tuple(head["warnings"]),
    )


def encode_keypoints(session: KeypointSession) -> bytes:
    """Write a session of keypoints, all of it: nobody needs its files again."""
    cameras, arrays = _cameras(session.cameras)
    head = {
        "cameras": cameras,
        "folders": dict(session.folders),
        "joints": asdict(session.joints),
        "timebase": asdict(session.timebase),
        "warnings": session.warnings,
    }
    arrays["head"] = np.array(json.dumps(head))
    for k, camera in enumerate(session.cameras):
        found = session.detections[camera.name]
        arrays[f"time_s_{k}"] = session.times[camera.name].time_s
        arrays |= {f"{name}_{k}": getattr(found, name) for name in _DETECTION_ARRAYS}
    return _encode(arrays)


def decode_keypoints(content: bytes) -> KeypointSession:
    """Read what ``encode_keypoints`` wrote."""
    arrays = _decode(content)
    head = json.loads(str(arrays["head"]))
    cameras = _decode_cameras(head["cameras"], arrays)
    return KeypointSession(
        cameras=cameras,
        times={camera.name: FrameTimes(arrays[f"time_s_{k}"]) for k, camera in enumerate(cameras)},
        timebase=Timebase(**head["timebase"]),
        detections={
            camera.name: Detections(camera.name, *(arrays[f"{name}_{k}"] for name in _DETECTION_ARRAYS))
            for k, camera in enumerate(cameras)
        },
        joints=JointSet(tuple(head["joints"]["names"]), tuple((one, other) for one, other in head["joints"]["bones"])),
        folders=head["folders"],
        warnings=tuple(head["warnings"]),
    )


def encode_detections(detections: Detections) -> bytes:
    """Write the detections of one camera."""
    arrays = {name: np.asarray(getattr(detections, name)) for name in _DETECTION_ARRAYS}
    return _encode({"camera": np.array(detections.camera), **arrays, **_damaged(detections)})


def decode_detections(content: bytes) -> Detections:
    """Read what ``encode_detections`` wrote."""
    arrays = _decode(content)
    return Detections(
        str(arrays["camera"]),
        damaged=arrays.get("damaged", no_frames()),
        **{name: arrays[name] for name in _DETECTION_ARRAYS},
    )


def _damaged(found: Detections | PafFields) -> dict[str, np.ndarray]:
    """Array of damaged frames; absent where there are none, for archives of undamaged videos keep their bytes."""
    return {"damaged": found.damaged} if len(found.damaged) else {}


def encode_fields(fields: PafFields) -> bytes:
    """Write the peaks and fields of one camera."""
    arrays = {name: np.asarray(getattr(fields, name)) for name in _FIELD_ARRAYS}
    grid = np.array([fields.grid.offset_px, fields.grid.pitch_px])
    return _encode({"camera": np.array(fields.camera), "grid": grid, **arrays, **_damaged(fields)})


def decode_fields(content: bytes) -> PafFields:
    """Read what ``encode_fields`` wrote."""
    arrays = _decode(content)
    offset_px, pitch_px = (tuple(row) for row in arrays["grid"].tolist())
    return PafFields(
        str(arrays["camera"]),
        grid=MapGrid(offset_px, pitch_px),
        damaged=arrays.get("damaged", no_frames()),
        **{name: arrays[name] for name in _FIELD_ARRAYS},
    )


def decode_damaged(content: bytes) -> Int[np.ndarray, " damaged"]:
    """Read the numbers of damaged frames, and nothing else, from what ``encode_fields`` wrote."""
    with _open(content) as archive:
        return archive["damaged"] if "damaged" in archive.files else no_frames()


def encode_lengths(lengths: LimbLengths, damaged: Sequence[DamagedVideo] = ()) -> bytes:
    """Write everybody's bone lengths, with the damaged videos among those that they were measured in."""
    return _encode({**lengths._asdict(), **_damaged_videos(damaged)})


def decode_lengths(content: bytes) -> LimbLengths:
    """Read the bone lengths that ``encode_lengths`` wrote."""
    arrays = _decode(content)
    return LimbLengths(**{name: arrays[name] for name in LimbLengths._fields})


def _damaged_videos(damaged: Sequence[DamagedVideo]) -> dict[str, np.ndarray]:
    """Array of damaged videos; absent where there are none."""
    return {_DAMAGED_VIDEOS: np.array(json.dumps([asdict(one) for one in damaged]))} if damaged else {}


def decode_damaged_videos(content: bytes | Path) -> tuple[DamagedVideo, ...]:
    """Read the damaged videos, and nothing else, from what ``encode_lengths`` or ``write_people`` wrote."""
    with _open(content) as archive:
        written = json.loads(str(archive[_DAMAGED_VIDEOS])) if _DAMAGED_VIDEOS in archive.files else []
    return tuple(DamagedVideo(**one) for one in written)


def encode_poses(poses: Poses3D) -> bytes:
    """Write the poses of a range of frames."""
    return _encode({name: np.asarray(getattr(poses, name)) for name in _POSE_ARRAYS})


def decode_poses(content: bytes) -> Poses3D:
    """Read what ``encode_poses`` wrote."""
    return Poses3D(**_decode(content))


def write_people(path: Path, people: People, damaged: Sequence[DamagedVideo] = ()) -> None:
    """Write tracks with the observations behind them, and the damaged videos among those that they come from.

    Into a file: beside all that is in it, the archive would take as much memory again.
    """
    arrays = _track_arrays(people.tracks) | _damaged_videos(damaged)
    arrays["num_approximate_frames"] = np.array(people.num_approximate_frames)
    for k, seen in enumerate(people.observations):
        arrays |= {f"points_px_{k}": seen.points_px, f"point_score_{k}": seen.score}
    with path.open("wb") as file:
        _save(file, arrays)


def open_people(path: Path) -> People:
    """Open what ``write_people`` wrote: a track or its observations are read whenever they are asked for."""

    def track(k: int) -> Track3D:
        with _open(path) as archive:
            return _track(archive, k)

    def observations(k: int) -> Observations:
        with _open(path) as archive:
            return Observations(int(archive["track_id"][k]), archive[f"points_px_{k}"], archive[f"point_score_{k}"])

    with _open(path) as archive:
        num_people, num_approximate_frames = len(archive["track_id"]), int(archive["num_approximate_frames"])
    return People(_Stored(num_people, track), _Stored(num_people, observations), num_approximate_frames)


def encode_animation(animation: Animation) -> bytes:
    """Write everybody's final positions and skeletons, and the floor."""
    motions, floor = animation.motions, animation.floor
    arrays: dict[str, np.ndarray] = {
        **_track_arrays(animation.tracks),
        "name": np.array([motion.name for motion in motions], dtype=np.str_),
        "frame_rate_hz": np.array([motion.frame_rate_hz for motion in motions], np.float64),
        "floor": np.array([] if floor is None else astuple(floor), np.float64),
    }
    for k, motion in enumerate(motions):
        arrays |= {
            f"bone_length_m_{k}": motion.bone_length_m,
            f"root_m_{k}": motion.root_m,
            f"parent_from_joint_{k}": motion.parent_from_joint,
            f"contacts_{k}": np.array([astuple(contact) for contact in motion.contacts], _CONTACT),
        }
    return _encode(arrays)


def decode_animation(content: bytes) -> Animation:
    """Read what ``encode_animation`` wrote."""
    arrays = _decode(content)
    tracks = _tracks(arrays)
    motions = tuple(
        SkeletonMotion(
            track.track_id,
            str(arrays["name"][k]),
            track.start_frame,
            float(arrays["frame_rate_hz"][k]),
            arrays[f"bone_length_m_{k}"],
            arrays[f"root_m_{k}"],
            arrays[f"parent_from_joint_{k}"],
            tuple(FootContact(*contact) for contact in arrays[f"contacts_{k}"].tolist()),
        )
        for k, track in enumerate(tracks)
    )
    return Animation(tracks, motions, Floor(*arrays["floor"].tolist()) if len(arrays["floor"]) else None)


def _track_arrays(tracks: Sequence[Track3D]) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {
        "track_id": np.array([track.track_id for track in tracks], np.int64),
        "start_frame": np.array([track.start_frame for track in tracks], np.int64),
    }
    return arrays | {f"{name}_{k}": getattr(track, name) for k, track in enumerate(tracks) for name in _TRACK_ARRAYS}


def _tracks(arrays: Mapping[str, np.ndarray]) -> tuple[Track3D, ...]:
    return tuple(_track(arrays, k) for k in range(len(arrays["track_id"])))


def _track(arrays: Mapping[str, np.ndarray], k: int) -> Track3D:
    values = (arrays[f"{name}_{k}"] for name in _TRACK_ARRAYS)
    return Track3D(int(arrays["track_id"][k]), int(arrays["start_frame"][k]), *values)
