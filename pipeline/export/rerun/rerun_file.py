"""Rerun file: cameras with pictures and detections, people, contacts and angles on two timelines.

``frame`` counts the output frames, ``time`` is the session's clock. The world has Z up, cameras look along +z with x to
the right and y down. Pixels are in the small pictures, and 0 is the outer edge of the first one, as Rerun has
them. Positions have single precision; if the world's origin is far away they are relative to ``origin_m``, a property
of the file. Cameras of Rerun are pinholes: the lens's distortion is not there.

Files are written and read by the package ``rerun-sdk``, the extra ``rerun``. Equal takes give equal contents, not equal
bytes: Rerun numbers its chunks by the clock.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Bool, Float, Int
from rerun.chunk import Chunk, RrdReader
from rerun.error_utils import RerunWarning

from pipeline.calibration.sizes import scaled
from pipeline.capture.session import Session
from pipeline.core.data.animation import FootContact, SkeletonMotion
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.detections import Detections, HeadRegions
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.progress import OnShare, ignore, split, sub_share
from pipeline.export.person_files import spoilt
from pipeline.export.rerun.rerun_pictures import is_unmatched, small_pictures, small_size_px
from pipeline.export.scene import Rgb, color_rgb, file_origin_m
from pipeline.export.timelines import frame_blocks
from pipeline.motion.angles.compute import joint_angles
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.skeleton.model import find_skeleton, forward_kinematics
from pipeline.video.timeline import frames_in

MAX_PICTURE_BYTES = 2**28
"""Largest size of all pictures of a file together, 256 MiB."""

_WORLD, _CAMERAS, _PEOPLE = "world", "world/cameras", "world/people"
_IMAGE, _UNMATCHED, _LOCATED, _SKELETON = "image", "nobody", "located", "skeleton"
_GREY: Rgb = (170, 170, 170)
# Bodies of an instant whose joints are told apart by classes, so that each has bones of its own.
_NUM_CLASSES = 64
_IMAGE_PLANE_M = 0.5
_RADIUS_M = 0.012
_RADIUS_UI = 2.5
# Pictures that wait until they are written.
_PICTURES_A_CHUNK = 32
# Numbers of single precision within a kilometre are less than 0.04 mm off.
_TOLERANCE_M = 1e-4


def _unblurred(_: str) -> HeadRegions | None:
    """Nothing is blurred in the pictures of a camera."""
    return None


@dataclass(frozen=True, slots=True)
class RecordedFootage:
    """Pictures and detections of the cameras of a take."""

    session: Session  # Session of the take, on measured clocks if they were measured
    # Bodies that were detected, by name of the camera; none of networks that leave fields
    detections: Mapping[str, Detections] = field(default_factory=dict)
    reading: Any = nullcontext  # Function that gives the block in which the video of a camera can be read
    # Function that gives the heads to be blurred in the pictures of a camera; ``None`` of it: none are
    heads: Callable[[str], HeadRegions | None] = _unblurred


def write_rerun(
    take: Reconstruction, path: Path, footage: RecordedFootage | None = None, on_share: OnShare = ignore
) -> None:
    """Write the Rerun file of a take, block by block, and read it back: the memory does not grow with its length.

    The file has its name when it is whole.

    ``footage``: pictures, and detections without a person; ``None``: the file has none. Raises ``InputError`` if a
    video can't be decoded; see ``pipeline.video.decode.decode``. Raises ``OSError`` if the file can't be written, or
    does not hold what was written.
    """
    part = path.with_name(f".part-{path.name}")
    try:
        part.touch()
        _Recorder(take, part).write(footage, sub_share(on_share, 0.0, 0.9))
        origin_m = file_origin_m(take.cameras)
        motions = {f"/{_PEOPLE}/person-{motion.track_id}/{_SKELETON}": motion for motion in take.motions}
        is_read = {entity: np.zeros(len(motion.root_m), bool) for entity, motion in motions.items()}
        try:
            for chunk in _chunks(part):
                if chunk.entity_path in motions and not chunk.is_static:
                    batch = chunk.to_record_batch()
                    rows = batch.column("frame").to_numpy(zero_copy_only=False) - motions[chunk.entity_path].start_frame
                    found_m = batch.column("Points3D:positions").flatten().flatten().to_numpy(zero_copy_only=False)
                    _compare(
                        found_m.reshape(-1, 3) + origin_m, rows, motions[chunk.entity_path], is_read[chunk.entity_path]
                    )
        except (ValueError, RuntimeError, KeyError, RerunWarning) as error:
            raise spoilt(path) from error
        if not all(rows.all() for rows in is_read.values()):
            raise spoilt(path)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    on_share(1.0)


class _Recorder:
    """Rerun file, to which a take is added."""

    def __init__(self, take: Reconstruction, path: Path) -> None:
        self._take, self._origin_m, self._path = take, file_origin_m(take.cameras), path
        self._file = rr.RecordingStream("multicap", default_enabled=True)

    def write(self, footage: RecordedFootage | None, on_share: OnShare) -> None:
        """Write all parts of the take, and close the file."""
        take = self._take
        has_pictures = {
            camera.name: footage is not None and camera.name in footage.session.camera_videos for camera in take.cameras
        }
        self._file.save(self._path, default_blueprint=_blueprint(take.cameras))
        try:
            if self._origin_m.any():
                self._file.send_property("take", rr.AnyValues(origin_m=self._origin_m))
            self._file.log(_WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            shown = {
                camera.name: scaled(camera, small_size_px(camera.size_px)) if has_pictures[camera.name] else camera
                for camera in take.cameras
            }
            weights = [5 if has_pictures[camera.name] else 1 for camera in take.cameras]
            on_cameras = split(sub_share(on_share, 0.0, 0.7), weights)
            for number, (camera, on_camera) in enumerate(zip(take.cameras, on_cameras, strict=True)):
                self._add_camera(shown[camera.name])
                if footage is not None and has_pictures[camera.name]:
                    max_bytes = MAX_PICTURE_BYTES // len(take.cameras)
                    self._add_pictures(footage, camera.name, max_bytes, on_camera)
                if footage is not None and camera.name in footage.detections:
                    self._add_unmatched(footage, number, shown[camera.name])
                on_camera(1.0)
            on_people = split(sub_share(on_share, 0.7, 1.0), [track.num_frames for track in take.tracks])
            for number, on_person in enumerate(on_people):
                self._add_person(number, [shown[camera.name] for camera in take.cameras])
                on_person(1.0)
        finally:
            self._file.flush()
            self._file.disconnect()

    def _add_camera(self, shown: Camera) -> None:
        place = shown.cam_from_world.inverse()
        matrix = np.array(shown.matrix)
        matrix[:2, 2] += 0.5  # the outer edge of the first pixel is at 0
        entity = _camera(shown.name)
        translation_m = place.translation_m - self._origin_m
        self._file.log(entity, rr.Transform3D(translation=translation_m, mat3x3=place.rotation), static=True)
        pinhole = rr.Pinhole(
            image_from_camera=matrix,
            resolution=shown.size_px,
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=_IMAGE_PLANE_M,
        )
        self._file.log(f"{entity}/{_IMAGE}", pinhole, static=True)

    def _add_pictures(self, footage: RecordedFootage, camera: str, max_bytes: int, on_share: OnShare) -> None:
        reading: AbstractContextManager[None] = footage.reading(camera)
        with reading:
            pictures = small_pictures(
                footage.session, self._take.timebase, camera, max_bytes, on_share, footage.heads(camera)
            )
            for _, group in groupby(enumerate(pictures), lambda item: item[0] // _PICTURES_A_CHUNK):
                chunk = [picture for _, picture in group]
                time_s = np.array([picture.time_s for picture in chunk])
                blobs = [np.frombuffer(picture.jpeg, np.uint8) for picture in chunk]
                columns = rr.EncodedImage.columns(blob=blobs, media_type=["image/jpeg"] * len(chunk))
                self._send(f"{_camera(camera)}/{_IMAGE}", self._nearest(time_s), time_s, columns)

    def _add_unmatched(self, footage: RecordedFootage, number: int, shown: Camera) -> None:
        """Add the bodies in a camera's pictures that no person was given, at the times of the pictures."""
        take, times = self._take, footage.session.times[shown.name]
        seconds = (take.timebase.time_s(row) for row in (-0.5, take.timebase.num_frames - 0.5))
        frames = frames_in(times, *seconds)
        detections = footage.detections[shown.name].within(frames)
        people = zip(take.tracks, take.observations, strict=False)
        is_free = is_unmatched(detections, times, number, take.timebase, people)
        body_frame, scale = detections.frame[is_free], np.array(shown.size_px) / take.cameras[number].size_px
        points_px = (detections.keypoints_px[is_free] + 0.5) * scale
        entity = f"{_camera(shown.name)}/{_IMAGE}/{_UNMATCHED}"
        names, bones = take.joints.names, [take.joints.indices(bone) for bone in take.joints.bones]
        self._log_classes(entity, [("nobody", _GREY)] * _NUM_CLASSES, names, bones)
        self._file.log(entity, rr.Points2D.from_fields(radii=_ui_radius(), show_labels=False), static=True)
        for rows in frame_blocks(len(frames)):
            ends = np.searchsorted(body_frame, [frames[rows].start, frames[rows].stop])
            self._send_bodies(entity, frames[rows], times.time_s, body_frame[slice(*ends)], points_px[slice(*ends)])

    def _send_bodies(
        self,
        entity: str,
        frames: range,
        camera_time_s: Float[np.ndarray, " camera_frames"],
        body_frame: Int[np.ndarray, " bodies"],
        points_px: Float[np.ndarray, "bodies joints 2"],
    ) -> None:
        """Write any number of bodies in each of some frames of a camera."""
        known = np.isfinite(points_px).all(-1)
        body, joint = np.nonzero(known)
        num_points = np.bincount(body_frame - frames.start, known.sum(1), len(frames)).astype(int)
        in_frame = np.arange(len(body_frame)) - np.searchsorted(body_frame, body_frame)
        columns = rr.Points2D.columns(
            positions=points_px[known], keypoint_ids=joint, class_ids=in_frame[body] % _NUM_CLASSES
        )
        time_s = camera_time_s[frames.start : frames.stop]
        self._send(entity, self._nearest(time_s), time_s, columns.partition(num_points))

    def _add_person(self, number: int, shown: Sequence[Camera]) -> None:
        """Add a person: what was seen in each camera, joints as they were located, skeleton, contacts and angles."""
        take = self._take
        track, motion = take.tracks[number], take.motions[number]
        names, bones = take.joints.names, [take.joints.indices(bone) for bone in take.joints.bones]
        classes, person = [(motion.name, color_rgb(track.track_id))], f"person-{track.track_id}"
        if number < len(take.observations):
            points_px = take.observations[number].points_px
            for column, camera in enumerate(shown):
                entity = f"{_camera(camera.name)}/{_IMAGE}/{person}"
                scale = np.array(camera.size_px) / take.cameras[column].size_px
                self._log_classes(entity, classes, names, bones)
                static = rr.Points2D.from_fields(class_ids=[0], radii=_ui_radius(), show_labels=False)
                self._file.log(entity, static, static=True)
                for rows in frame_blocks(track.num_frames):
                    self._send_joints(entity, track.frames[rows], (points_px[rows, column] + 0.5) * scale)
                self._end(entity, track.frames, len(names), 2)
        if number < len(take.located):
            located = take.located[number]
            entity = self._body(person, _LOCATED, classes, names, bones)
            for rows in frame_blocks(located.num_frames):
                self._send_joints(entity, located.frames[rows], located.xyz_m[rows] - self._origin_m)
            self._end(entity, located.frames, len(names), 3)
        joints = find_skeleton(len(motion.bone_length_m))
        names = tuple(joint.name for joint in joints)
        bones = [[names.index(joint.parent), end] for end, joint in enumerate(joints) if joint.parent is not None]
        entity = self._body(person, _SKELETON, classes, names, bones)
        for rows, positions_m in _motion_blocks(motion):
            self._send_joints(entity, motion.frames[rows], positions_m - self._origin_m)
        self._end(entity, motion.frames, len(names), 3)
        self._add_contacts(person, motion)
        self._add_angles(person, motion, track)

    def _body(
        self, person: str, part: str, classes: Sequence[tuple[str, Rgb]], names: Sequence[str], bones: Sequence[Any]
    ) -> str:
        """Entity of a person's joints in the world, with names, bones and colour."""
        entity = f"{_PEOPLE}/{person}/{part}"
        self._log_classes(entity, classes, names, bones)
        self._file.log(
            entity, rr.Points3D.from_fields(class_ids=[0], radii=[_RADIUS_M], show_labels=False), static=True
        )
        return entity

    def _add_contacts(self, person: str, motion: SkeletonMotion) -> None:
        """Add the confidence in the contacts of each foot, or part of it; 0 without contact."""

        def kind(contact: FootContact) -> tuple[str, str]:
            return contact.side, contact.part

        for (side, part), contacts in groupby(sorted(motion.contacts, key=kind), kind):
            confidence = np.zeros(len(motion.root_m))
            for contact in contacts:
                confidence[contact.rows] = contact.confidence
            self._add_series(f"contacts/{person}/{side}_{part}", motion, confidence)

    def _add_angles(self, person: str, motion: SkeletonMotion, track: Track3D) -> None:
        """Add the joint angles that are ever known, in degrees; NaN where one is unknown."""
        angles = joint_angles(motion, track, self._take.joints, has_sigmas=False)
        for name, column in zip(ANGLE_NAMES, angles.angle_deg.T, strict=True):
            if np.isfinite(column).any():
                self._add_series(f"angles/{person}/{name}", motion, column)

    def _add_series(self, entity: str, motion: SkeletonMotion, values: Float[np.ndarray, " frames"]) -> None:
        """Add a time series in the colour of a person."""
        series = rr.SeriesLines(colors=[color_rgb(motion.track_id)], names=[entity.partition("/")[2]])
        self._file.log(entity, series, static=True)
        for rows in frame_blocks(len(values)):
            frames = motion.frames[rows]
            self._send(entity, frames, self._times_s(frames), rr.Scalars.columns(scalars=values[rows]))

    def _log_classes(
        self, entity: str, classes: Sequence[tuple[str, Rgb]], names: Sequence[str], bones: Sequence[Any]
    ) -> None:
        """Give the joints of an entity names and bones; each class has a label and a colour."""
        described = [
            rr.ClassDescription(
                info=rr.AnnotationInfo(id=number, label=label, color=rgb),
                keypoint_annotations=[rr.AnnotationInfo(id=id, label=name) for id, name in enumerate(names)],
                keypoint_connections=[(int(start), int(end)) for start, end in bones],
            )
            for number, (label, rgb) in enumerate(classes)
        ]
        self._file.log(entity, rr.AnnotationContext(described), static=True)

    def _send_joints(self, entity: str, frames: range, positions: Float[np.ndarray, "frames joints axes"]) -> None:
        """Write the known joints of a person in some output frames, in pixels or in metres."""
        known = np.isfinite(positions).all(-1)
        kind = rr.Points2D if positions.shape[-1] == 2 else rr.Points3D
        columns = kind.columns(positions=positions[known], keypoint_ids=np.nonzero(known)[1])
        self._send(entity, frames, self._times_s(frames), columns.partition(known.sum(1)))

    def _end(self, entity: str, frames: range, num_joints: int, num_axes: int) -> None:
        """Write that no person is there after some frames; what was written last holds otherwise."""
        if frames.stop < self._take.timebase.num_frames:
            unseen = np.full((1, num_joints, num_axes), np.nan)
            self._send_joints(entity, range(frames.stop, frames.stop + 1), unseen)

    def _send(
        self,
        entity: str,
        frames: Sequence[int] | Int[np.ndarray, " rows"],
        time_s: Float[np.ndarray, " rows"],
        columns: Any,
    ) -> None:
        """Write values at some times."""
        indexes = [rr.TimeColumn("frame", sequence=np.asarray(frames)), rr.TimeColumn("time", duration=time_s)]
        self._file.send_columns(entity, indexes=indexes, columns=columns)
        self._file.flush()  # blocks don't pile up in memory

    def _times_s(self, frames: range) -> Float[np.ndarray, " frames"]:
        timebase: Timebase = self._take.timebase
        return timebase.start_time_s + np.arange(frames.start, frames.stop) / timebase.frame_rate_hz

    def _nearest(self, time_s: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Nearest output frames of some times."""
        timebase = self._take.timebase
        frame = np.rint((time_s - timebase.start_time_s) * timebase.frame_rate_hz).astype(int)
        return np.clip(frame, 0, timebase.num_frames - 1)


def _camera(name: str) -> str:
    return f"{_CAMERAS}/{rr.escape_entity_path_part(name)}"


def _ui_radius() -> list[Any]:
    """Radius of points in pictures, the same however far one zooms."""
    return [rr.components.Radius.ui_points(_RADIUS_UI)]


def _motion_blocks(motion: SkeletonMotion) -> Iterator[tuple[slice, Float[np.ndarray, "frames joints 3"]]]:
    """World positions of a skeleton's joints, block by block."""
    for rows in frame_blocks(len(motion.root_m)):
        block = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
        yield rows, forward_kinematics(block)


def _blueprint(cameras: Sequence[Camera]) -> rrb.Blueprint:
    """Layout of the viewer: the world beside the cameras, angles and contacts below."""
    views = [rrb.Spatial2DView(origin=f"{_camera(camera.name)}/{_IMAGE}", name=camera.name) for camera in cameras]
    series = rrb.Horizontal(
        rrb.TimeSeriesView(origin="angles", name="angles"), rrb.TimeSeriesView(origin="contacts", name="contacts")
    )
    spatial = rrb.Horizontal(rrb.Spatial3DView(origin=_WORLD, name="world"), rrb.Grid(*views))
    return rrb.Blueprint(rrb.Vertical(spatial, series, row_shares=[2, 1]), collapse_panels=True)


def _chunks(path: Path) -> Iterator[Chunk]:
    """Chunks of a file; a warning that it is not whole is raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RerunWarning)
        reader = RrdReader(path)
    yield from reader.stream()


def _compare(
    found_m: Float[np.ndarray, "points 3"],
    rows: Int[np.ndarray, " rows"],
    motion: SkeletonMotion,
    is_read: Bool[np.ndarray, " frames"],
) -> None:
    """Compare the joints of a skeleton in some rows with the motion; ``ValueError`` if they differ."""
    rows = rows[rows < len(motion.root_m)]  # the row after the last one is empty
    block = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
    expected_m = forward_kinematics(block).reshape(-1, 3)
    if found_m.shape != expected_m.shape or np.abs(found_m - expected_m).max(initial=0.0) > _TOLERANCE_M:
        raise ValueError("The joints of a skeleton differ.")
    is_read[rows] = True
