"""Outputs of stages: NumPy archives without pickles, byte-identical for equal records."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, replace
from pathlib import Path

import numpy as np

from pipeline.capture.preflight_npz import DETECTION_ARRAYS
from pipeline.clustering.bone_lengths import LimbLengths
from pipeline.data import (
    Animation,
    Camera,
    CameraBump,
    CameraClock,
    CameraMove,
    ClockEvidence,
    DamagedVideo,
    Detections,
    Doubt,
    Floor,
    FootContact,
    Leftovers,
    MapGrid,
    Observations,
    PafFields,
    People,
    PictureChanges,
    Poses3D,
    Refinement,
    SkeletonMotion,
    Synchronization,
    Track3D,
    WorldMove,
    no_detections,
    no_frames,
    read_only,
)
from pipeline.detect.profiles.sizes import CameraSizes
from pipeline.edits import PersonSpan
from pipeline.errors import Problem
from pipeline.geometry.rigid import Rigid3
from pipeline.runtime.npz import decode_arrays, encode_arrays, open_archive, save_arrays
from pipeline.stages.stored import StoredSequence

_FIELD_ARRAYS = ("frame", "peak_row", "peak_joint", "peak_px", "peak_score", "fields", "limbs")
_POSE_ARRAYS = ("frame", "xyz_m", "points_px", "score", "approximate")
_TRACK_ARRAYS = ("xyz_m", "score", "source", "error_px", "views")
_LEFTOVER_ARRAYS = ("frame", "camera", "points_px", "score")
_UNCERTAINTY = "uncertainty_m"
_CONTACT = np.dtype(
    [
        ("side", "U5"),
        ("start_frame", np.int64),
        ("num_frames", np.int64),
        ("confidence", np.float64),
        ("pinned", np.bool_),
        ("slide_before_m", np.float64),
        ("slide_after_m", np.float64),
        ("part", "U4"),
    ]
)
_DOUBT = np.dtype([("frame", np.int64), ("confidence", np.float64), ("other", np.int64)])
_CHANGE_ARRAYS = ("frame", "change", "first", "last")
_DAMAGED_VIDEOS = "damaged_videos"


def encode_sizes(sizes: CameraSizes) -> bytes:
    """Write the sizes of a camera's images."""
    border_px = np.nan if sizes.border_px is None else sizes.border_px
    return encode_arrays({"scaled_px": np.array(sizes.scaled_px, np.int64), "border_px": np.array(border_px)})


def decode_sizes(content: bytes) -> CameraSizes:
    """Read what ``encode_sizes`` wrote."""
    arrays = decode_arrays(content)
    border_px = float(arrays["border_px"])
    return CameraSizes(tuple(arrays["scaled_px"].tolist()), None if np.isnan(border_px) else border_px)


def encode_refinement(cameras: Sequence[Camera], refinement: Refinement) -> bytes:
    """Write refined cameras, and the report of the refinement."""
    return encode_arrays(
        {
            "matrix": np.array([camera.matrix for camera in cameras]),
            "rotation": np.array([camera.cam_from_world.rotation for camera in cameras]),
            "translation_m": np.array([camera.cam_from_world.translation_m for camera in cameras]),
            "report": np.array(json.dumps(asdict(refinement))),
        }
    )


def decode_refinement(cameras: Sequence[Camera], content: bytes) -> tuple[tuple[Camera, ...], Refinement]:
    """Read what ``encode_refinement`` wrote.

    Parameters
    ----------
    cameras
        The session's cameras: names, sizes and distortion are theirs.
    """
    arrays = decode_arrays(content)
    rows = zip(cameras, arrays["matrix"], arrays["rotation"], arrays["translation_m"], strict=True)
    refined = tuple(
        replace(
            camera,
            matrix=read_only(matrix.copy()),
            cam_from_world=Rigid3(read_only(rotation.copy()), read_only(translation_m.copy())),
        )
        for camera, matrix, rotation, translation_m in rows
    )
    report = json.loads(str(arrays["report"]))
    report["moved"] = tuple(CameraMove(**move) for move in report["moved"])
    report["bumped"] = tuple(CameraBump(**bump) for bump in report["bumped"])
    report["world"] = None if report["world"] is None else WorldMove(**report["world"])
    return refined, Refinement(**report)


def encode_clocks(synchronization: Synchronization) -> bytes:
    """Write measured clocks."""
    return json.dumps(asdict(synchronization), sort_keys=True).encode()


def decode_clocks(content: bytes) -> Synchronization:
    """Read what ``encode_clocks`` wrote."""
    document = json.loads(content)
    return Synchronization(
        tuple(CameraClock(**clock) for clock in document["clocks"]),
        warnings=tuple(Problem(**problem) for problem in document["warnings"]),
        evidence=tuple(
            ClockEvidence(one["camera"], tuple(one["offsets_s"]), tuple(one["disagreement"]))
            for one in document["evidence"]
        ),
    )


def encode_detections(detections: Detections) -> bytes:
    """Write the detections of one camera without their colours, which are not kept with a session."""
    arrays = {name: np.asarray(getattr(detections, name)) for name in DETECTION_ARRAYS}
    return encode_arrays({"camera": np.array(detections.camera), **arrays, **_of_pictures(detections)})


def decode_detections(content: bytes) -> Detections:
    """Read what ``encode_detections`` wrote; there are no colours in it."""
    arrays = decode_arrays(content)
    return Detections(
        str(arrays["camera"]),
        damaged=arrays.get("damaged", no_frames()),
        changes=_decode_changes(arrays),
        **{name: arrays[name] for name in DETECTION_ARRAYS},
    )


def encode_colours(detections: Detections) -> bytes:
    """Write the colours of the detections of one camera."""
    return encode_arrays({"colour": detections.colour})


def with_colours(detections: Detections, content: bytes) -> Detections:
    """Add the colours that ``encode_colours`` wrote to their detections."""
    return replace(detections, colour=decode_arrays(content)["colour"])


def _of_pictures(found: Detections | PafFields) -> dict[str, np.ndarray]:
    """Arrays of damaged frames, absent where there are none, and of the pictures' changes, where they were measured."""
    changes = {f"picture_{name}": getattr(found.changes, name) for name in _CHANGE_ARRAYS}
    return ({"damaged": found.damaged} if len(found.damaged) else {}) | (changes if len(found.changes.frame) else {})


def _decode_changes(arrays: Mapping[str, np.ndarray]) -> PictureChanges:
    names = {name: f"picture_{name}" for name in _CHANGE_ARRAYS}
    return PictureChanges(**{name: arrays[key] for name, key in names.items() if key in arrays})


def encode_fields(fields: PafFields) -> bytes:
    """Write the peaks and fields of one camera."""
    arrays = {name: np.asarray(getattr(fields, name)) for name in _FIELD_ARRAYS}
    grid = np.array([fields.grid.offset_px, fields.grid.pitch_px])
    return encode_arrays({"camera": np.array(fields.camera), "grid": grid, **arrays, **_of_pictures(fields)})


def decode_fields(content: bytes) -> PafFields:
    """Read what ``encode_fields`` wrote."""
    arrays = decode_arrays(content)
    offset_px, pitch_px = (tuple(row) for row in arrays["grid"].tolist())
    return PafFields(
        str(arrays["camera"]),
        grid=MapGrid(offset_px, pitch_px),
        damaged=arrays.get("damaged", no_frames()),
        changes=_decode_changes(arrays),
        **{name: arrays[name] for name in _FIELD_ARRAYS},
    )


def encode_lengths(lengths: LimbLengths, damaged: Sequence[DamagedVideo] = ()) -> bytes:
    """Write everybody's bone lengths, with the damaged videos among those that they were measured in."""
    return encode_arrays({**lengths._asdict(), **_damaged_videos(damaged)})


def decode_lengths(content: bytes) -> LimbLengths:
    """Read the bone lengths that ``encode_lengths`` wrote."""
    arrays = decode_arrays(content)
    return LimbLengths(**{name: arrays[name] for name in LimbLengths._fields})


def _damaged_videos(damaged: Sequence[DamagedVideo]) -> dict[str, np.ndarray]:
    """Array of damaged videos; absent where there are none."""
    return {_DAMAGED_VIDEOS: np.array(json.dumps([asdict(one) for one in damaged]))} if damaged else {}


def decode_damaged_videos(content: bytes | Path) -> tuple[DamagedVideo, ...]:
    """Read the damaged videos, and nothing else, from what ``encode_lengths`` or ``write_people`` wrote."""
    with open_archive(content) as archive:
        written = json.loads(str(archive[_DAMAGED_VIDEOS])) if _DAMAGED_VIDEOS in archive.files else []
    return tuple(DamagedVideo(**{**one, "doubled_s": tuple(one["doubled_s"])}) for one in written)


def encode_poses(poses: Poses3D) -> bytes:
    """Write the poses of a range of frames."""
    return encode_arrays({name: np.asarray(getattr(poses, name)) for name in _POSE_ARRAYS})


def decode_poses(content: bytes) -> Poses3D:
    """Read what ``encode_poses`` wrote."""
    return Poses3D(**decode_arrays(content))


def write_people(path: Path, people: People, damaged: Sequence[DamagedVideo] = ()) -> None:
    """Write tracks with the observations behind them, and the damaged videos among those that they come from.

    Into a file: beside all that is in it, the archive would take as much memory again.
    """
    arrays = _track_arrays(people.tracks) | _damaged_videos(damaged)
    arrays["num_approximate_frames"] = np.array(people.num_approximate_frames)
    arrays["num_doubts"] = np.array([len(of_person) for of_person in people.doubts], np.int64)
    arrays["doubts"] = np.array([one for of_person in people.doubts for one in of_person], _DOUBT)
    if people.leftovers is not None:
        arrays |= {f"left_{name}": getattr(people.leftovers, name) for name in _LEFTOVER_ARRAYS}
    for k, seen in enumerate(people.observations):
        arrays |= {f"points_px_{k}": seen.points_px, f"point_score_{k}": seen.score}
        if len(seen.detection):
            arrays[f"detection_{k}"] = seen.detection
    with path.open("wb") as file:
        save_arrays(file, arrays)


def open_people(path: Path) -> People:
    """Open what ``write_people`` wrote: a track or its observations are read whenever they are asked for."""

    def track(k: int) -> Track3D:
        with open_archive(path) as archive:
            return _track(archive, k)

    def observations(k: int) -> Observations:
        with open_archive(path) as archive:
            name = f"detection_{k}"
            return Observations(
                int(archive["track_id"][k]),
                archive[f"points_px_{k}"],
                archive[f"point_score_{k}"],
                archive[name] if name in archive.files else no_detections(),
            )

    with open_archive(path) as archive:
        num_people, num_approximate_frames = len(archive["track_id"]), int(archive["num_approximate_frames"])
        all_doubts = iter(archive["doubts"].tolist())
        doubts = [[Doubt(*next(all_doubts)) for _ in range(number)] for number in archive["num_doubts"].tolist()]
        has_leftovers = f"left_{_LEFTOVER_ARRAYS[0]}" in archive.files
        leftovers = Leftovers(*(archive[f"left_{name}"] for name in _LEFTOVER_ARRAYS)) if has_leftovers else None
    tracks, seen = StoredSequence(num_people, track), StoredSequence(num_people, observations)
    return People(tracks, seen, num_approximate_frames, doubts, leftovers)


def stored_spans(path: Path) -> tuple[PersonSpan, ...]:
    """Frames of the people that ``write_people`` wrote, in their order; the rest of their tracks is not read."""
    with open_archive(path) as archive:
        people = zip(archive["track_id"].tolist(), archive["start_frame"].tolist(), strict=True)
        return tuple(PersonSpan(number, start, len(archive[f"source_{k}"])) for k, (number, start) in enumerate(people))


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
    return encode_arrays(arrays)


def decode_animation(content: bytes) -> Animation:
    """Read what ``encode_animation`` wrote."""
    arrays = decode_arrays(content)
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


def decode_floor(content: bytes) -> Floor | None:
    """Read the floor alone of what ``encode_animation`` wrote."""
    with open_archive(content) as archive:
        return Floor(*archive["floor"].tolist()) if len(archive["floor"]) else None


def _track_arrays(tracks: Sequence[Track3D]) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {
        "track_id": np.array([track.track_id for track in tracks], np.int64),
        "start_frame": np.array([track.start_frame for track in tracks], np.int64),
    }
    for k, track in enumerate(tracks):
        arrays |= {f"{name}_{k}": getattr(track, name) for name in _TRACK_ARRAYS}
        if track.uncertainty_m is not None:
            arrays[f"{_UNCERTAINTY}_{k}"] = track.uncertainty_m
    return arrays


def _tracks(arrays: Mapping[str, np.ndarray]) -> tuple[Track3D, ...]:
    return tuple(_track(arrays, k) for k in range(len(arrays["track_id"])))


def _track(arrays: Mapping[str, np.ndarray], k: int) -> Track3D:
    values = {name: arrays[f"{name}_{k}"] for name in _TRACK_ARRAYS}
    # Absent for tracks without uncertainty.
    uncertainty_m = arrays.get(f"{_UNCERTAINTY}_{k}")
    return Track3D(int(arrays["track_id"][k]), int(arrays["start_frame"][k]), uncertainty_m=uncertainty_m, **values)
