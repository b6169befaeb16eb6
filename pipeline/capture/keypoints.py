"""Open a session of 2D joints that another program detected: a folder a camera.

``keypoint_files`` reads the folders in the forms of other programs (docs/reference/reader-tables.md): a file for each
frame such as ``frame_000000000123_keypoints.json``, or a file of all frames. A joint is undetected if its score is 0 or
less, or if a number is not finite. People without a detected joint are left out. A missing frame is a dropped frame.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import read_contents, read_intrinsics
from pipeline.capture.camera_files import find_input, known_recordings
from pipeline.capture.keypoint_files.folders import Source, camera_folders, read_folder, stated_folders
from pipeline.capture.keypoint_files.layout_choice import rearranged, tell_layout
from pipeline.capture.keypoint_files.own_points import OwnFrames, split_own
from pipeline.capture.keypoint_files.people import People, find_joint_set, is_detected
from pipeline.capture.keypoint_files.readers import openpose
from pipeline.capture.keypoint_files.scales import rescaled
from pipeline.capture.keypoint_files.timestamps import timebase_of, times_from_file, times_from_rate
from pipeline.capture.pairing import pair
from pipeline.capture.preflight_record import LayoutRead, Recording
from pipeline.core.data.arrays import short_text
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.laboratory import Laboratory
from pipeline.core.data.own_points import OwnDetections
from pipeline.core.errors import InputError, Problem
from pipeline.core.findings import Finding
from pipeline.core.joints import JointSet
from pipeline.core.layouts import FILE_LAYOUTS, KeypointLayout
from pipeline.core.options.arguments import checked
from pipeline.core.options.job_choices import Units, Up
from pipeline.core.paths import StrPath
from pipeline.core.problems import session_codes
from pipeline.core.problems.finding_codes import CALIBRATION_NOTE, CAMERA_SAW_NOBODY, KEYPOINTS_FORM
from pipeline.core.problems.request_codes import SESSION_TOO_LARGE
from pipeline.core.runtime import large_arrays
from pipeline.video.info import VideoInfo
from pipeline.video.timeline import cut_timebase, frames_in, recorded_stretches, require_frames, span_s

MAX_JOINTS = 75_000_000
"""Limit on the joints of a session, detected or not: an hour of ten people, four cameras, 17 joints and 30 Hz.

The check of the files uses about 36 bytes of memory a joint.
"""
_LARGE_HINT = "Cut it into several captures."
_MAX_NAMED = 10


@dataclass(frozen=True, slots=True, eq=False)
class KeypointSession:
    """Calibrated cameras and the 2D joints detected in their frames.

    Parameters
    ----------
    cameras
        Cameras in the order of the calibration.
    times
        Frame times of each camera on the session's clock, by camera name.
    timebase
        Output frames, from the earliest camera's first frame on. Without timestamps, frame k is file number
        ``first_source_frame + k``.
    detections
        Detections by camera name.
    joints
        Joint set of the detections.
    folders
        Name of the folder of each camera, by camera name.
    findings
        What the user should know of the files.
    layout
        Layout of points that the files do not name; ``None`` if the format or the files name them.
    own
        Points of the user's own, which are no joints of ours.
    laboratory
        Records of a laboratory beside the cameras; ``None``: none.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> session.joints.names[:2]
    ('nose', 'left_eye')
    """

    cameras: tuple[Camera, ...]
    times: Mapping[str, FrameTimes]
    timebase: Timebase
    detections: Mapping[str, Detections]
    joints: JointSet
    folders: Mapping[str, str]
    findings: tuple[Finding, ...]
    layout: LayoutRead | None = None
    own: OwnDetections = field(default_factory=OwnDetections)
    laboratory: Laboratory | None = None

    __repr__ = short_text

    @property
    def starts_s(self) -> dict[str, float]:
        """Time 0 of each camera, by camera name: the origin of timestamps and frame numbers."""
        return dict.fromkeys(self.times, 0.0)

    @property
    def offset_std_s(self) -> dict[str, float]:
        """Uncertainties of declared offsets, by camera name: timestamps have none."""
        return {}

    @property
    def stretches(self) -> tuple[range, ...]:
        """Ranges of all output frames without long pauses in the detections; see ``recorded_stretches``."""
        return recorded_stretches(
            self.timebase, (self.times[name].time_s[detections.frame] for name, detections in self.detections.items())
        )

    @property
    def camera_videos(self) -> Mapping[str, VideoInfo]:
        """Videos by camera name: there are none."""
        return {}

    def restricted(self, frames: range | None) -> "KeypointSession":
        """Restrict the session to a range of its output frames (``None``: all), which are numbered from 0.

        Raises ``InputError`` if the session has no such frames.
        """
        if frames is None:
            return self
        require_frames(self.timebase, frames)
        span = span_s(self.timebase, frames.start, frames.stop)
        taken = {camera: frames_in(times, *span) for camera, times in self.times.items()}
        inside = {camera: detections.within(taken[camera]) for camera, detections in self.detections.items()}
        timebase = cut_timebase(self.timebase, frames)
        return replace(self, timebase=timebase, detections=inside, own=self.own.within(taken))

    def at_times(self, times: Mapping[str, FrameTimes], timebase: Timebase) -> "KeypointSession":
        """Session whose frames were taken at other times, with the output frames of all of it."""
        return replace(self, times=times, timebase=timebase)

    def outline(self) -> "KeypointSession":
        """Session without what takes most memory: its detections."""
        return replace(self, detections={}, own=OwnDetections(self.own.names))


@checked
def open_keypoints(
    folder: StrPath | Mapping[str, StrPath],
    calibration: StrPath,
    timestamps: StrPath | None = None,
    frame_rate_hz: float | None = None,
    units: Units | None = None,
    max_joints: int | None = None,
    pair_by_order: bool = False,
    *,
    recordings: Sequence[Recording] = (),
    keeps_poses: bool = True,
    up: Up = "z",
    layout: str | None = None,
) -> KeypointSession:
    """Open a folder that contains a folder of keypoint files for each camera.

    A folder belongs to the camera whose name is a word in its name. Cameras without a folder are left out.

    Parameters
    ----------
    folder
        Folder of the cameras' folders, or the folder of each camera by the camera's name, whatever the folders' names.
    timestamps, frame_rate_hz
        CSV file with the columns ``camera``, ``frame`` and ``time_s``; or the rate of all cameras.
    units, up, keeps_poses
        See ``open_session``.
    max_joints
        Limit on the joints of all people in all files, detected or not; ``None``: no limit.
    pair_by_order
        Pair folders without a camera by the natural order of the names; a warning lists the pairs.
    recordings
        Names of some cameras' folders, in ``file`` of a recording; such a camera is never left out.
    layout
        Layout of points without names; ``None``: the number of points and the people tell it.

    Returns
    -------
    KeypointSession
        Cameras in the order of the calibration; distorted pixels, NaN with score 0 for undetected joints.

    Raises
    ------
    InputError
        With all problems of all files.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> len(session.cameras), session.timebase.frame_rate_hz
    (3, 25.0)
    """
    calibration = Path(calibration)
    timestamps = None if timestamps is None else Path(timestamps)
    problems: list[Problem] = []
    findings: list[Finding] = []
    cameras: tuple[Camera, ...] = ()
    try:
        contents = read_contents(calibration, units, up) if keeps_poses else read_intrinsics(calibration)
        cameras = contents.cameras
        findings += [Finding(CALIBRATION_NOTE, note, severity="info") for note in contents.notes]
        problems += [_unknown_size(camera, calibration) for camera in cameras if camera.size_px == UNKNOWN_SIZE]
    except InputError as error:
        problems.extend(error.problems)
    used = [path for path in (calibration, timestamps) if path is not None]
    folders, pairs = _paired(folder, used, cameras, recordings, pair_by_order, findings, problems)
    camera_of = {name: camera for camera, name in pairs.items()}
    sizes_px = {camera.name: camera.size_px for camera in cameras}
    chosen = None if layout is None else _chosen(layout, problems)
    forms, counts = set[str](), dict[str, frozenset[int]]()
    frames, own = dict[str, dict[int, People]](), dict[str, tuple[str, ...]]()
    left_joints = sys.maxsize if max_joints is None else max_joints
    for name, path in folders.items():
        camera = camera_of.get(name, name)
        contents_of = read_folder(path, camera, sizes_px.get(camera), left_joints, findings, problems)
        frames[name] = contents_of.frames
        counts[name], own[name] = contents_of.counts, contents_of.own
        forms |= contents_of.forms
        left_joints -= contents_of.num_joints
        if left_joints < 0:
            message = f"With this camera's files the capture has more than {max_joints:,} joints."
            problems.append(Problem(SESSION_TOO_LARGE, message, camera=camera_of.get(name, name), hint=_LARGE_HINT))
            raise InputError(problems)
    frames |= rescaled(frames, pairs, sizes_px, findings, problems)
    beside = _split_own(frames, own)
    posed = cameras if keeps_poses else ()
    read = _in_layout(frames, counts, camera_of, posed, chosen, findings, problems)
    joints = _joint_set(frames, problems)
    if joints is not None and max_joints is not None and _num_joints(frames, joints) > max_joints:
        message = f"With hands for all people the capture has more than {max_joints:,} joints."
        problems.append(Problem(SESSION_TOO_LARGE, message, hint=_LARGE_HINT))
        raise InputError(problems)
    people_by_camera = {camera: frames[name] for camera, name in pairs.items()}
    if timestamps is not None and frame_rate_hz is not None:
        problems.append(
            Problem(
                session_codes.TWO_CLOCKS,
                "There are both timestamps and a frame rate.",
                hint="Provide only one of them.",
            )
        )
    times, timebase = (
        times_from_rate(people_by_camera, pairs, frame_rate_hz, findings, problems)
        if timestamps is None
        else times_from_file(people_by_camera, timestamps, problems)
    )
    if not problems and forms != {openpose.read_frame.name}:
        message = f"The keypoints are read in the form of {' and '.join(sorted(forms))}."
        findings.append(Finding(KEYPOINTS_FORM, message, severity="info", evidence={"forms": sorted(forms)}))
    own_by_camera = {camera: beside[1][name] for camera, name in pairs.items() if beside[0]}
    given = joints, pairs, times, timebase, read, (beside[0], own_by_camera)
    return _session(cameras, people_by_camera, *given, findings, problems)


def _split_own(
    frames: dict[str, dict[int, People]], own: Mapping[str, tuple[str, ...]]
) -> tuple[tuple[str, ...], dict[str, OwnFrames]]:
    """Take own points out of the people of each folder; their names, and the points by folder."""
    names = tuple(dict.fromkeys(name for of_folder in own.values() for name in of_folder))
    beside: dict[str, OwnFrames] = {}
    for folder in frames if names else ():
        frames[folder], beside[folder] = split_own(frames[folder], own.get(folder, ()), names)
    return names, beside


def _session(
    cameras: Sequence[Camera],
    people: Mapping[str, Mapping[int, People]],
    joints: JointSet | None,
    folders: Mapping[str, str],
    times: Mapping[str, FrameTimes],
    timebase: Timebase | None,
    layout: LayoutRead | None,
    own: tuple[tuple[str, ...], Mapping[str, OwnFrames]],
    findings: list[Finding],
    problems: Sequence[Problem],
) -> KeypointSession:
    """Put a session together; raises ``InputError`` with the problems that were found."""
    if problems or joints is None or timebase is None:
        raise InputError(problems)
    num_joints, (names, own_by_camera) = len(joints.names), own
    if names:
        shown = ", ".join(names[:_MAX_NAMED]) + (", ..." if len(names) > _MAX_NAMED else "")
        message = f"{len(names)} points of the files are no joints; they are followed as points of your own: {shown}."
        findings.append(Finding(KEYPOINTS_FORM, message, severity="info", evidence={"points": list(names)}))
    has_animals = any(map(len, (rows for points in own_by_camera.values() for rows in points.of_animals)))
    if has_animals:
        message = (
            "Shoulders or hips have no point: rows are followed as animals. They get points in 3D with deviations, and "
            "no skeleton fit, joint angles, or identity; clustering needs a file with their bones."
        )
        hint = "If they are people, name the points like left_shoulder and right_hip."
        findings.append(Finding(KEYPOINTS_FORM, message, hint=hint))
    findings += [
        Finding(CAMERA_SAW_NOBODY, f"Camera {camera} saw no people.", camera, hint="Check the detector's output.")
        for camera, by_frame in people.items()
        if not sum(map(len, by_frame.values())) and not has_animals
    ]
    return KeypointSession(
        cameras=tuple(camera for camera in cameras if camera.name in people),
        times=times,
        timebase=timebase,
        detections={
            camera: _as_detections(camera, list(by_frame.values()), num_joints) for camera, by_frame in people.items()
        },
        own=OwnDetections(
            names,
            *(
                {camera: _as_detections(camera, part[k], len(names)) for camera, part in own_by_camera.items()}
                for k in range(3)
            ),
        ),
        joints=joints,
        folders=folders,
        findings=tuple(findings),
        layout=layout,
    )


def session_of_frames(
    cameras: Sequence[Camera],
    people: dict[str, dict[int, People]],
    counts: Mapping[str, frozenset[int]],
    layout: str | None,
    frame_rate_hz: float | None,
    times: Mapping[str, FrameTimes],
    findings: list[Finding],
    problems: list[Problem],
    own: Mapping[str, tuple[str, ...]],
) -> KeypointSession:
    """Put a session together from the people of each camera's frames in memory; see ``keypoint_files.people``.

    ``counts`` are the numbers of points that have no names, by camera; ``own`` the names of own points among the
    points of ``people``. ``times`` are used without a frame rate.
    """
    chosen = None if layout is None else _chosen(layout, problems)
    names = {camera: camera for camera in people}
    beside = _split_own(people, own)
    read = _in_layout(people, counts, names, cameras, chosen, findings, problems)
    joints, timebase = _joint_set(people, problems), None
    if frame_rate_hz is not None:
        times, timebase = times_from_rate(people, names, frame_rate_hz, findings, problems)
    elif not problems:
        timebase = timebase_of(times, people, "", problems)
    return _session(cameras, people, joints, names, times, timebase, read, beside, findings, problems)


def _paired(
    folder: StrPath | Mapping[str, StrPath],
    used: Sequence[Path],
    cameras: Sequence[Camera],
    recordings: Sequence[Recording],
    by_order: bool,
    findings: list[Finding],
    problems: list[Problem],
) -> tuple[Mapping[str, Source], Mapping[str, str]]:
    """Folders by name, and the name of each camera's folder: as stated, or by the names."""
    if isinstance(folder, Mapping):
        folders = stated_folders(folder, cameras, problems)
        if not cameras or not folders:
            return folders, {}
        pairing = pair(cameras, [], "folder", {camera: camera for camera in folders}, by_order=by_order)
    else:
        folders = camera_folders(Path(folder), findings, problems, used)
        if not cameras or not folders:
            return folders, {}
        places = [Path(name) for name in folders]
        known, recording_problems = known_recordings(recordings, cameras, places, "folder")
        if recording_problems:
            problems += recording_problems
            return folders, {}
        found = {camera: find_input(recording.file, places) for camera, recording in known.items() if recording.file}
        stated = {camera: place.name for camera, place in found.items() if place is not None}
        free = [name for name in folders if name not in stated.values()]
        pairing = pair(cameras, free, "folder", stated, known, by_order)
    problems += pairing.problems
    findings += pairing.findings
    return folders, pairing.pairs


def _chosen(layout: str, problems: list[Problem]) -> KeypointLayout | None:
    if layout not in FILE_LAYOUTS:
        hint = f"Use {', '.join(FILE_LAYOUTS)}."
        problems.append(
            Problem(session_codes.KEYPOINTS_LAYOUT, f"There is no layout {layout!r}.", field="layout", hint=hint)
        )
    return FILE_LAYOUTS.get(layout)


def _in_layout(
    frames: dict[str, dict[int, People]],
    counts: Mapping[str, frozenset[int]],
    camera_of: Mapping[str, str],
    cameras: Sequence[Camera],
    chosen: KeypointLayout | None,
    findings: list[Finding],
    problems: list[Problem],
) -> LayoutRead | None:
    """Put the joints of the layout in place of points that the files do not name; return how the layout was told.

    ``counts`` are numbers of such points by folder, none for files that name their points. ``cameras`` have poses.
    """
    nums_points = set().union(*counts.values())
    if not nums_points and chosen is not None and any(map(len, frames.values())):
        message = f"The format of the files names their points: the layout {chosen.name} is not used."
        findings.append(Finding(KEYPOINTS_FORM, message, hint="State no layout.", evidence={"stated": chosen.name}))
    names = [name for name in frames if counts[name]]
    is_empty = not any(len(people) for name in names for people in frames[name].values())
    if len(nums_points) != 1 or is_empty:  # files with several numbers of points have no joint set in common
        return None
    by_camera = {camera_of.get(name, name): frames[name] for name in names}
    read = tell_layout(by_camera, nums_points.pop(), cameras, chosen, findings, problems)
    if read is not None:
        order = FILE_LAYOUTS[read.name]
        for name in names:
            frames[name] = {number: rearranged(people, order) for number, people in frames[name].items()}
    return read


def _unknown_size(camera: Camera, calibration: Path) -> Problem:
    message = "The calibration does not contain the size of the picture, which keypoints need."
    hint = (
        "Add image_width and image_height to each camera of the file, or write a file that has the size: "
        f"multicap calibration convert {calibration.name} sized.json --size 1920x1080."
    )
    return Problem(
        session_codes.INVALID_SIZE, message, file=calibration.name, camera=camera.name, field="size", hint=hint
    )


def _joint_set(frames: Mapping[str, Mapping[int, People]], problems: list[Problem]) -> JointSet | None:
    """Joint set of all files; ``None`` and a problem if the files differ or have no joints."""
    counts = {name: {people.shape[1] for people in by_frame.values()} - {0} for name, by_frame in frames.items()}
    used = set().union(*counts.values()) if counts else set()
    if not used:
        if frames and not problems:
            message, hint = "No camera detected a person.", "Check the detector's output."
            problems.append(Problem(session_codes.KEYPOINTS_EMPTY, message, hint=hint))
        return None
    joints = find_joint_set(used)
    if joints is None:
        shown = ", ".join(
            f"{name}: {' and '.join(str(count) for count in sorted(of_camera))} joints"
            for name, of_camera in counts.items()
            if of_camera
        )
        message = f"The files have several joint sets ({shown})."
        problems.append(Problem(session_codes.KEYPOINTS_MIXED, message, hint="Use one joint set for all files."))
    return joints


def _num_joints(frames: Mapping[str, Mapping[int, People]], joints: JointSet) -> int:
    """Number of the joints of all people, detected or not, hands of people without any included."""
    return len(joints.names) * sum(len(people) for by_frame in frames.values() for people in by_frame.values())


def _as_detections(camera: str, frames: Sequence[People], num_joints: int) -> Detections:
    """Build the detections of a camera; frames are numbered by their position in ``times``."""
    people = large_arrays.concatenate(
        [
            np.empty((0, num_joints, 3)),
            *(_padded(people_of_frame, num_joints) for people_of_frame in frames if len(people_of_frame)),
        ]
    )
    detected = is_detected(people)
    keypoints_px, score = large_arrays.copy(people[..., :2]), large_arrays.copy(people[..., 2])
    keypoints_px[~detected], score[~detected] = np.nan, 0.0
    return Detections(
        camera=camera,
        frame=np.repeat(np.arange(len(frames)), [len(people_of_frame) for people_of_frame in frames]),
        keypoints_px=keypoints_px,
        score=np.clip(score, 0.0, 1.0, out=score),
        box_px=_boxes(keypoints_px),
    )


def _padded(people: People, num_joints: int) -> People:
    """People with undetected fingers if they are bodies only."""
    missing = num_joints - people.shape[1]
    return people if not missing else np.pad(people, ((0, 0), (0, missing), (0, 0)))


def _boxes(keypoints_px: Float[np.ndarray, "n joints 2"]) -> Float[np.ndarray, "n 4"]:
    """Boxes around detected joints as (left, top, right, bottom); NaN without a detected joint."""
    known = np.isfinite(keypoints_px)
    low = np.where(known, keypoints_px, np.inf).min(1, initial=np.inf)
    high = np.where(known, keypoints_px, -np.inf).max(1, initial=-np.inf)
    boxes = np.concatenate([low, high], axis=1)
    return np.where(np.isfinite(boxes), boxes, np.nan)
