"""Open a capture session of videos and a calibration; all problems are reported at once."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pipeline.calibration.camera_names import name_problem
from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import read_contents, read_intrinsics
from pipeline.calibration.sizes import fit_to_video, guessed_camera
from pipeline.capture.camera_files import SortedFiles, known_recordings, left_out_parts, sort_files
from pipeline.capture.clock import TimeSource, clock_problems, slow_motion
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.pairing import MIN_CAMERAS, pair
from pipeline.capture.preflight_record import Clock, LayoutRead, Recording
from pipeline.capture.starts import clock_findings, start_hint, starts_s
from pipeline.capture.video_files import find_videos
from pipeline.core.data.arrays import short_text
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.laboratory import Laboratory
from pipeline.core.errors import InputError, Problem
from pipeline.core.findings import Finding, Severity
from pipeline.core.options.arguments import checked
from pipeline.core.options.job_choices import Units, Up
from pipeline.core.parsing import FRAME_RATE_HZ, FRAME_RATE_TOLERANCE, OFFSET_S
from pipeline.core.paths import StrPath
from pipeline.core.problems import finding_codes
from pipeline.core.problems.session_codes import FRAME_RATE, INVALID_NAME, NO_FRAME_RATE, OFFSET_RANGE, SIZE_MISMATCH
from pipeline.video.frame_rate import OF_TIMES, measured_rate_hz, without_rounding
from pipeline.video.images.files import SEQUENCE
from pipeline.video.images.image_probe import at_rate
from pipeline.video.info import VideoInfo
from pipeline.video.joined import join_parts, seam_problems
from pipeline.video.timeline import cut_timebase, recorded_stretches, require_frames, session_timebase


@dataclass(frozen=True, slots=True, eq=False)
class CaptureSession:
    """Calibrated cameras and their videos.

    Parameters
    ----------
    cameras, videos
        One of each for a view, in the order of the calibration.
    times
        Frame times of each camera on the session's clock, by camera name.
    findings
        What the user should know of the files.
    frames
        Range of the output frames to reconstruct; ``None``: all.
    whole_timebase
        Output frames of the session, if the times were corrected afterwards; ``None``: the frames of the times.
    offset_std_s
        Standard deviation of a camera's declared offset, by camera name, where it is stated.
    laboratory
        Records of a laboratory beside the cameras; ``None``: none.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_session(folder / "videos", folder / "calibration.json")
    >>> len(session.cameras) == len(session.videos), session.timebase.frame_rate_hz
    (True, 25.0)
    """

    cameras: tuple[Camera, ...]
    videos: tuple[VideoInfo, ...]
    times: Mapping[str, FrameTimes]
    findings: tuple[Finding, ...]
    frames: range | None = None
    whole_timebase: Timebase | None = None
    offset_std_s: Mapping[str, float] = field(default_factory=dict)
    laboratory: Laboratory | None = None

    __repr__ = short_text

    @property
    def timebase(self) -> Timebase:
        """Output frames to reconstruct, numbered from 0."""
        whole = self.whole_timebase or session_timebase(self.times)
        return whole if self.frames is None else cut_timebase(whole, self.frames)

    @property
    def starts_s(self) -> dict[str, float]:
        """Time of each camera's first frame on the session's clock, by camera name."""
        return {name: float(of_camera.time_s[0]) for name, of_camera in self.times.items()}

    @property
    def stretches(self) -> tuple[range, ...]:
        """Ranges of all output frames without long pauses; see ``recorded_stretches``."""
        return recorded_stretches(
            session_timebase(self.times), (camera_times.time_s for camera_times in self.times.values())
        )

    @property
    def camera_videos(self) -> Mapping[str, VideoInfo]:
        """Video of each camera, by camera name, in the cameras' order."""
        return {camera.name: video for camera, video in zip(self.cameras, self.videos, strict=True)}

    @property
    def layout(self) -> LayoutRead | None:
        """Layout of keypoints: there are none."""
        return None

    def restricted(self, frames: range | None) -> "CaptureSession":
        """Restrict the session to a range of its output frames (``None``: all), which are numbered from 0.

        Raises ``InputError`` if the session has no such frames.
        """
        if frames is not None:
            require_frames(self.timebase, frames)
        return self if frames is None else replace(self, frames=frames)

    def at_times(self, times: Mapping[str, FrameTimes], timebase: Timebase) -> "CaptureSession":
        """Session whose frames were taken at other times, with the output frames of all of it."""
        return replace(self, times=times, whole_timebase=timebase)

    def outline(self) -> "CaptureSession":
        """Session without what takes most memory: the session itself, whose videos are files."""
        return self


Session = CaptureSession | KeypointSession
"""A session of videos or of keypoints. Both have the same members, but for videos and detections."""


@checked
def open_session(
    videos: StrPath | Sequence[StrPath],
    calibration: StrPath | None,
    recordings: Sequence[Recording] = (),
    units: Units | None = None,
    clock: Clock = "declared",
    images_rate_hz: float | None = None,
    pair_by_order: bool = False,
    *,
    keeps_poses: bool = True,
    up: Up = "z",
) -> CaptureSession:
    """Open a folder of videos, or a list of videos, with a calibration.

    A video belongs to the camera whose name is a word in its name. Cameras without a video are left out.

    Parameters
    ----------
    calibration
        ``None``: it is to be made from the videos. The cameras have their names, and are guessed.
    recordings
        Facts about the videos of some cameras, at most one recording a camera.
    units, up
        See ``read_contents``.
    clock
        Clock of the videos' starts; offsets of ``recordings`` are added.
    images_rate_hz
        Frame rate of sequences of images, folders or zip archives in place of videos, whose recordings state none.
    pair_by_order
        Pair videos without a camera by the natural order of the names; a warning lists the pairs.
    keeps_poses
        True if the calibration's poses count; else it may have intrinsics alone, and poses in any unit.

    Returns
    -------
    CaptureSession
        Cameras with a video, in the order of the calibration, and frame times in seconds.

    Raises
    ------
    InputError
        With all problems of all files.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_session(folder / "videos", folder / "calibration.json")
    >>> [video.num_frames for video in session.videos]
    [3, 3, 3]
    """
    from pipeline.video.probe_process import probe_in_children  # noqa: PLC0415 - loads FFmpeg, which only this needs

    files = find_videos(Path(videos) if isinstance(videos, str | os.PathLike) else [Path(video) for video in videos])
    findings, problems = [*files.findings], files.problems(1 if calibration is None else MIN_CAMERAS)
    cameras: tuple[Camera, ...] = ()
    if calibration is not None:
        try:
            path = Path(calibration)
            contents = read_contents(path, units, up) if keeps_poses else read_intrinsics(path)
            cameras = contents.cameras
            findings += [Finding(finding_codes.CALIBRATION_NOTE, note, severity="info") for note in contents.notes]
        except InputError as error:
            problems.extend(error.problems)

    results = probe_in_children(files.paths)
    problems.extend(result for result in results if isinstance(result, Problem))
    infos = {path: result for path, result in zip(files.paths, results, strict=True) if isinstance(result, VideoInfo)}
    footage = sort_files(files, recordings, cameras)
    problems += footage.problems
    if calibration is None:
        cameras = _guessed(footage, infos)
        problems += [
            Problem(INVALID_NAME, f"The name {fault}", camera=camera.name, field="name", hint="Rename the video.")
            for camera in cameras
            if (fault := name_problem(camera.name))
        ]
    problems += _range_problems(recordings)
    recording_of_camera, recording_problems = (
        known_recordings(recordings, cameras, files.paths) if cameras else ({}, [])
    )
    problems += recording_problems
    if cameras and not recording_problems:
        stated = {
            camera: footage.stated[recording.camera]
            for camera, recording in recording_of_camera.items()
            if recording.camera in footage.stated
        }
        labels = {camera: paths[0].name for camera, paths in stated.items()}
        pairing = pair(cameras, list(footage.free), "video", labels, recording_of_camera.keys(), pair_by_order)
        problems += pairing.problems
        findings += pairing.findings
        files_of = {camera: stated.get(camera) or footage.free[name] for camera, name in pairing.pairs.items()}
        videos_of = _joined(files_of, infos, findings, problems)
        cameras = _fitted([camera for camera in cameras if camera.name in pairing.pairs], videos_of, findings, problems)
    if problems:
        raise InputError(problems)
    stated_hz = {name: recording.frame_rate_hz for name, recording in recording_of_camera.items()}
    rates_hz = {name: stated_hz.get(name) or images_rate_hz for name in videos_of}
    if problems := _without_rate(videos_of, rates_hz):
        raise InputError(problems)
    paired = {camera.name: _placed(videos_of[camera.name], rates_hz[camera.name]) for camera in cameras}
    start_s, without_clock = starts_s(paired, clock)
    if without_clock:
        raise InputError(without_clock)
    times = {name: _times(video, start_s[name], recording_of_camera.get(name)) for name, video in paired.items()}
    if problems := [*_rate_problems(times, paired), *_clock_problems(times, paired, clock)]:
        raise InputError(problems)
    findings += [_repeated_times(name, video) for name, video in paired.items() if video.num_repeated]
    findings += [
        _of_video(name, doubt)
        for name, video in paired.items()
        for doubt in video.warnings
        # A stated rate takes the place of the times.
        if doubt.code not in OF_TIMES or video.codec == SEQUENCE or stated_hz.get(name) is None
    ]
    findings += clock_findings(paired, clock)
    findings += slow_motion(times, {name: video.path.name for name, video in paired.items() if not stated_hz.get(name)})
    return CaptureSession(
        cameras, tuple(paired.values()), times, tuple(findings), offset_std_s=_stds_s(recording_of_camera)
    )


def _stds_s(recordings: Mapping[str, Recording]) -> dict[str, float]:
    """Standard deviations of declared offsets by camera, where they are stated."""
    stds_s = {name: recording.offset_std_s for name, recording in recordings.items()}
    return {name: std_s for name, std_s in stds_s.items() if std_s is not None}


def _range_problems(recordings: Sequence[Recording]) -> list[Problem]:
    """Report stated offsets and frame rates that are out of range."""
    stated = [
        (
            OFFSET_RANGE,
            "offset_s",
            OFFSET_S,
            recording.camera,
            recording.offset_s,
            "Count from the start of the capture.",
        )
        for recording in recordings
    ]
    stated += [
        (
            FRAME_RATE,
            "rate",
            FRAME_RATE_HZ,
            recording.camera,
            recording.frame_rate_hz,
            "State the rate in frames a second.",
        )
        for recording in recordings
        if recording.frame_rate_hz is not None
    ]
    return [
        Problem(code, f"{value:g} is not within {allowed}.", camera=camera, field=field, hint=hint)
        for code, field, allowed, camera, value, hint in stated
        if not allowed.holds(value)
    ]


def _without_rate(videos: Mapping[str, VideoInfo], rates_hz: Mapping[str, float | None]) -> list[Problem]:
    """Report sequences of images without a frame rate."""
    message, hint = "Images have no times: their frame rate must be stated.", "State it in frames a second."
    return [
        Problem(NO_FRAME_RATE, message, file=video.path.name, camera=name, field="rate", hint=hint)
        for name, video in videos.items()
        if video.codec == SEQUENCE and rates_hz[name] is None
    ]


def _placed(video: VideoInfo, rate_hz: float | None) -> VideoInfo:
    """Give the frames of a sequence of images their times; a video has its own."""
    return video if video.codec != SEQUENCE or rate_hz is None else at_rate(video, rate_hz)


def _times(video: VideoInfo, start_s: float, recording: Recording | None) -> FrameTimes:
    if recording is None:
        return FrameTimes(start_s + video.time_s)
    rate_hz = recording.frame_rate_hz
    own_s = (
        video.time_s
        if rate_hz is None or video.codec == SEQUENCE
        else np.arange(len(video.time_s)) / float(without_rounding(rate_hz))
    )
    return FrameTimes(start_s + recording.offset_s + own_s)


def _rate_problems(times: Mapping[str, FrameTimes], videos: Mapping[str, VideoInfo]) -> list[Problem]:
    """Report cameras with a measured frame rate out of range."""
    rates_hz = {name: measured_rate_hz(camera_times.time_s) for name, camera_times in times.items()}
    return [
        Problem(
            FRAME_RATE,
            f"By its timestamps the video has {rate_hz:g} frames a second; {FRAME_RATE_HZ} are allowed.",
            file=videos[name].path.name,
            camera=name,
            field="rate",
            hint="If the timestamps are wrong, state the frame rate of the video, or export it again.",
        )
        for name, rate_hz in rates_hz.items()
        if not FRAME_RATE_HZ.holds(rate_hz, FRAME_RATE_TOLERANCE)
    ]


def _clock_problems(times: Mapping[str, FrameTimes], videos: Mapping[str, VideoInfo], clock: Clock) -> list[Problem]:
    start_s = min(float(camera_times.time_s[0]) for camera_times in times.values())
    rate_hz = max(measured_rate_hz(camera_times.time_s) for camera_times in times.values())
    source = TimeSource(
        files={name: video.path.name for name, video in videos.items()},
        start_field="offset_s",
        rate_field="rate",
        start_hint=start_hint(clock),
        rate_hint="If the timestamps of the video are wrong, state its frame rate. Or cut the capture into several.",
    )
    return clock_problems(times, start_s, rate_hz, source)


def _guessed(footage: SortedFiles, infos: Mapping[Path, VideoInfo]) -> tuple[Camera, ...]:
    named = {**footage.stated, **{name.replace("/", "_"): paths for name, paths in footage.free.items()}}
    in_order = sorted(named.items(), key=lambda item: footage.places[item[1][0]])
    return tuple(guessed_camera(name, infos[paths[0]].size_px) for name, paths in in_order if paths[0] in infos)


def _joined(
    files_of: Mapping[str, Sequence[Path]],
    infos: Mapping[Path, VideoInfo],
    findings: list[Finding],
    problems: list[Problem],
) -> dict[str, VideoInfo]:
    """Video of each camera whose files can be read; report parts that don't fit together, tell of those that do."""
    videos = {}
    for camera, paths in files_of.items():
        parts = [infos[path] for path in paths if path in infos]
        if len(parts) < len(paths):
            continue
        if len(parts) == 1:
            videos[camera] = parts[0]
            continue
        if wrong := [*left_out_parts([path.stem for path in paths]), *seam_problems(parts)]:
            problems += [replace(problem, camera=camera) for problem in wrong]
            continue
        videos[camera] = join_parts(parts)
        names = [path.name for path in paths]
        lengths = " + ".join(f"{part.num_frames / part.frame_rate_hz:.1f}" for part in parts)
        message = f"{camera}: {', '.join(names)} are joined as the parts of one recording of {lengths} s."
        hint = "State the file of the camera if they are not."
        findings.append(Finding(finding_codes.PARTS_JOINED, message, camera, "info", hint, {"files": names}))
    return videos


def _of_video(camera: str, doubt: Problem) -> Finding:
    """Finding of what is doubtful about a video's file."""
    message = str(replace(doubt, hint=None))
    severity: Severity = (
        "info" if doubt.code in {finding_codes.FIRST_PICTURE_MOVED, finding_codes.SOUND_DELAY_UNKNOWN} else "warning"
    )
    return Finding(doubt.code, message, camera, severity, doubt.hint, evidence={"file": doubt.file})


def _repeated_times(camera: str, video: VideoInfo) -> Finding:
    frames = "1 frame is" if video.num_repeated == 1 else f"{video.num_repeated} frames are"
    return Finding(
        finding_codes.FRAMES_REPEATED,
        f"{video.path.name}: {frames} left out, because another frame has the same timestamp.",
        camera,
        hint="Export the video again at a constant frame rate.",
        evidence={"file": video.path.name, "num_frames": video.num_repeated},
    )


def _fitted(
    cameras: Sequence[Camera], videos: Mapping[str, VideoInfo], findings: list[Finding], problems: list[Problem]
) -> tuple[Camera, ...]:
    """Adapt cameras to the pictures of their videos; tell of each adapted camera, report those that don't fit."""
    fitted = []
    for camera in cameras:
        video = videos.get(camera.name)
        if video is None or video.size_px == camera.size_px:
            fitted.append(camera)
            continue
        found = fit_to_video(camera, video.size_px, video.rotation_deg, video.stored_size_px, video.is_mirrored)
        if found is None:
            problems.append(_size_problem(camera, video))
        else:
            fitted.append(found[0])
            findings.append(
                Finding(
                    finding_codes.CALIBRATION_ADAPTED,
                    f"{camera.name}: {_sizes(camera, video)}; {found[1]}.",
                    camera.name,
                    hint="Calibrate at the size of the videos if the guess is wrong.",
                    evidence={
                        "file": video.path.name,
                        "video_size_px": list(video.size_px),
                        "calibration_size_px": list(camera.size_px),
                    },
                )
            )
    return tuple(fitted)


def _sizes(camera: Camera, video: VideoInfo) -> str:
    (width, height), (calibrated_width, calibrated_height) = video.size_px, camera.size_px
    if camera.size_px == UNKNOWN_SIZE:
        return f"the video has {width} x {height} pixels, the calibration does not contain a size"
    return f"the video has {width} x {height} pixels, the calibration {calibrated_width} x {calibrated_height}"


def _size_problem(camera: Camera, video: VideoInfo) -> Problem:
    hint = "Calibrate at the size of the videos."
    if video.size_px == camera.size_px[::-1]:
        hint = (
            "The picture seems to be turned by a quarter, but the video file does not say in which direction. Turn the "
            "video, or calibrate with turned pictures."
        )
    if camera.size_px == UNKNOWN_SIZE:
        hint = "The principal point of the calibration is not near the middle of the picture: check the sizes."
    message = _sizes(camera, video)
    return Problem(
        SIZE_MISMATCH,
        f"{message[0].upper()}{message[1:]}.",
        file=video.path.name,
        camera=camera.name,
        field="size",
        hint=hint,
    )
