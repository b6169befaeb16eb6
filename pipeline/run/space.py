"""Space, memory and work that a reconstruction is foreseen to need, before it starts. Standard library only.

Bytes of a person and frame were measured on stored outputs and result files of jobs;
``tests/pipeline/run/test_space.py`` compares the sum with what jobs write. How many people a video shows is known after
detection only: three are assumed.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pipeline.capture.preflight_record import Preflight
from pipeline.core.options.config import JointsOfBody, Profile, ReconstructionConfig
from pipeline.core.options.file_formats import FILE_FORMATS, Export
from pipeline.run.engine import stage
from pipeline.run.engine.stage import Cut, FrameCut

_ASSUMED_PEOPLE = 3
_NUM_JOINTS: Mapping[str, int] = {"body": 17, "feet": 23, "whole": 65}
_OF_ONE_NETWORK = 17
# Share of the cameras of a video session that see a person at a time.
_SEEING = 0.8

# Bytes of outputs of stages: of a joint of a track in a frame, of a view of it, of a detection of it, of it in a fit
# and in other smoothing; of a person's rotations in a frame, and of a camera's frame in the searches for missed people.
_TRACK, _VIEW, _DETECTION, _FITTED, _SMOOTHED = 49, 18, 21, 24, 16
_POSE, _OF_FRAME = 900, 80
# Of a person in a frame: points of the feet; and until the job ends the state of the fit, without and of each joint.
_FEET, _STATE, _STATE_OF_JOINT = 75, 600, 40
# Of a view of a joint in a frame: arrays of tracking, which are in files from a size on (``large_arrays``).
_MAPPED, _MIN_MAPPED = 96, 2**27
_FIELDS_OF_FRAME: Mapping[str, int] = {"openpose-mobilenet-thin": 17_000, "human-pose-estimation-0001": 5_800}
# With fingers a skeleton has so many times as many joints, and a task takes as many times the memory. Bodies without
# them have at most so many joints.
_WITH_FINGERS, _MOST_OF_BODY = 2.0, 25

# Bytes of result files: of a take and a person, of a person's frame, and of a joint in it.
_METRICS_OF_TAKE, _METRICS_OF_PERSON = 12_000, 12_000
_VIEWER_OF_TAKE, _VIEWER_OF_PERSON, _VIEWER_OF_FRAME, _VIEWER_OF_JOINT = 27_000, 7_500, 240, 8
_SKELETON_OF_JOINT = 42
_REPORT_OF_CAMERA, _REPORT_OF_FRAME = 150_000, 250
# Bytes of a pixel of overlay and blurred videos, and of a picture in a recording; longest sides of their pictures.
_VIDEO_OF_PIXEL, _PICTURE_OF_PIXEL = 0.01, 0.2
_OVERLAY_SIDE_PX, _BLURRED_SIDE_PX, _RECORDED_SIDE_PX = 1280, 960, 640
_RECORDED_HZ, _MAX_RECORDED_BYTES = 10.0, 2**28
_RECORDED_OF_JOINT = 235
# Formats of characters, and bytes of a frame of their motion.
_OF_CHARACTERS, _CHARACTER_OF_FRAME = frozenset({"bvh", "glb", "fbx"}), 1_000

# Memory of a worker process at work on a full HD video.
_PROCESS_BYTES = 300 * 2**20
# Memory of each detected joint, and of each person in a frame, that a task on the whole session holds: in arrays, of
# which large ones are in files (``large_arrays``), and beside them. ``tests/worker/run/test_stage_memory.py`` holds all
# stages to them.
_ARRAYS_OF_JOINT, _ARRAYS_OF_PERSON, _MAX_ARRAYS = 65, 5_000, 2**28
_MEMORY_OF_JOINT, _MEMORY_OF_PERSON = 8, 1_500


@dataclass(frozen=True, slots=True)
class CameraFrames:
    """Frames of a camera, and for keypoints what was detected in them."""

    size_px: tuple[int, int]  # Width and height
    num_frames: int
    num_bodies: int | None = None  # Bodies in all frames; ``None`` of videos
    num_joints: int | None = None  # Joints of a body; ``None`` of videos


@dataclass(frozen=True, slots=True)
class ForeseenSpace:
    """Space that a reconstruction is foreseen to need."""

    output_bytes: int  # Outputs of stages, which later jobs of the session reuse
    result_bytes: int  # Result files
    scratch_bytes: int  # Temporary files of the largest task, beside these, and the states of fits until the job ends
    num_people: int  # Number of people that was assumed

    @property
    def store_bytes(self) -> int:
        """Space in the store after the job."""
        return self.output_bytes + self.result_bytes


@dataclass(frozen=True, slots=True)
class ForeseenMemory:
    """Memory that tasks of a reconstruction are foreseen to need."""

    part_bytes: int  # Of a task on a part of the session: a camera, or a range of frames
    whole_bytes: int  # Of a task that holds everybody in all frames

    def task_bytes(self, cut: Cut) -> int:
        """Memory of a task of a stage that is cut so."""
        return self.whole_bytes if cut in {"whole", "people"} else self.part_bytes


def shown_bytes(num_bytes: float) -> str:
    """Amount of bytes as people read it.

    >>> shown_bytes(3_000_000)
    '2.9 MiB'
    """
    for unit in ("KiB", "MiB"):
        num_bytes /= 1024
        if num_bytes < 1024:
            return f"{num_bytes:.1f} {unit}"
    return f"{num_bytes / 1024:.1f} GiB"


def foreseen_space(preflight: Preflight, config: ReconstructionConfig, character_bytes: int = 0) -> ForeseenSpace:
    """Space that a job of a session needs in the service: with files for viewers, and pieces for edits.

    ``character_bytes`` is the size of the character that moves as each person, if there is one.
    """
    cameras = [
        CameraFrames(camera.size_px, camera.num_frames, camera.num_bodies, camera.num_joints)
        for camera in preflight.cameras
    ]
    timebase = preflight.timebase
    frames = timebase.num_frames, timebase.frame_rate_hz, preflight.stretches
    return estimate_space(cameras, *frames, config, has_viewers=True, character_bytes=character_bytes)


def foreseen_memory(preflight: Preflight, config: ReconstructionConfig) -> ForeseenMemory:
    """Memory that tasks of a job need in the service. Every task on keypoints holds all of them."""
    counted = [camera for camera in preflight.cameras if camera.num_bodies is not None]
    if counted:
        num_joints = float(sum((camera.num_bodies or 0) * (camera.num_joints or 0) for camera in counted))
        of_body = max(camera.num_joints or 0 for camera in counted)
        # In the frames of the camera that sees most of them.
        num_people = float(max(camera.num_bodies or 0 for camera in counted))
    else:
        wanted = len(config.frames or range(preflight.timebase.num_frames)) / max(1, preflight.timebase.num_frames)
        of_body = _NUM_JOINTS[config.detected_joints] if config.detector == "auto" else _OF_ONE_NETWORK
        num_frames = wanted * sum(camera.num_frames for camera in preflight.cameras)
        num_joints = _ASSUMED_PEOPLE * _SEEING * num_frames * of_body
        num_people = _ASSUMED_PEOPLE * wanted * preflight.timebase.num_frames
    whole_bytes = _PROCESS_BYTES + memory_of_people(num_joints, num_people, of_body)
    return ForeseenMemory(whole_bytes if counted else _PROCESS_BYTES, whole_bytes)


def memory_of_people(num_joints: float, num_people: float, of_body: int) -> int:
    """Bytes of everybody in a task on the whole session.

    ``num_joints``: joints that were detected in all frames of all cameras. ``num_people``: people in all frames of the
    session. ``of_body``: joints of a body, fingers included.
    """
    array_bytes = min(_ARRAYS_OF_JOINT * num_joints + _ARRAYS_OF_PERSON * num_people, _MAX_ARRAYS)
    other_bytes = _MEMORY_OF_JOINT * num_joints + _MEMORY_OF_PERSON * num_people
    return round(_times_of_fingers(of_body) * (array_bytes + other_bytes))


def _times_of_fingers(num_joints: float) -> float:
    """Factor of the fingers that may be among the joints of a body."""
    return _WITH_FINGERS if num_joints > _MOST_OF_BODY else 1.0


def estimate_space(
    cameras: Sequence[CameraFrames],
    num_frames: int,
    frame_rate_hz: float,
    stretches: tuple[range, ...],
    config: ReconstructionConfig,
    *,
    has_viewers: bool,
    character_bytes: int = 0,
) -> ForeseenSpace:
    """Space that the reconstruction of a session needs.

    ``num_frames``, ``frame_rate_hz``, ``stretches``: output frames of the session, and those that have to be worked on.
    ``has_viewers``: whether files for viewers are made, and pieces are kept for edits of people. ``character_bytes``:
    size of the character that moves as each person, if there is one.
    """
    wanted = config.frames or range(num_frames)
    num_worked = FrameCut(wanted, stretches, config.chunk_frames).num_frames
    share = num_worked / max(1, sum(map(len, stretches)))
    counted = [camera for camera in cameras if camera.num_bodies is not None]
    num_joints, num_people, num_views = _of_people(cameras, counted, sum(map(len, stretches)), config)
    rows = num_people * num_worked
    people_bytes = rows * num_joints * (_TRACK + _VIEW * num_views)
    turns = _times_of_fingers(num_joints)
    fit_bytes = rows * (turns * _POSE + _FEET + num_joints * (_FITTED if config.smoothing == "fit" else _SMOOTHED))
    output_bytes = 2 * people_bytes + fit_bytes + 5_000 * (num_people + 1)
    if config.method == "clustering":
        output_bytes += people_bytes
    if not counted:
        output_bytes += share * sum(camera.num_frames for camera in cameras) * _detected(config, num_people, num_joints)
    rate = 1.0 if config.output_rate_hz is None else config.output_rate_hz / frame_rate_hz
    in_files = rate * num_people * (num_worked if config.timeline == "person" else len(wanted))
    of_people = _export_bytes(config.exports, num_people, in_files, num_joints, turns)
    kept_bytes = _METRICS_OF_TAKE + _METRICS_OF_PERSON * num_people + rate * rows * num_joints * _SKELETON_OF_JOINT
    kept_bytes += sum(of_people.values())
    result_bytes = kept_bytes + sum(of_people[export] for export in of_people if FILE_FORMATS[export].in_take)
    if not counted:
        result_bytes += _pictures(cameras, config, share, frame_rate_hz, rows, num_joints)
    if character_bytes:
        num_files = sum(export in _OF_CHARACTERS for export in config.exports)
        result_bytes += num_files * (num_people * character_bytes + in_files * _CHARACTER_OF_FRAME)
    if has_viewers:
        viewer_bytes = _VIEWER_OF_TAKE + _VIEWER_OF_PERSON * num_people
        viewer_bytes += rows * (_VIEWER_OF_FRAME + _VIEWER_OF_JOINT * num_joints)
        result_bytes += viewer_bytes
        # Copies of these files are kept as pieces, for edits of people.
        output_bytes += kept_bytes + viewer_bytes
    state_bytes = rows * (_STATE + num_joints * _STATE_OF_JOINT)
    scratch_bytes = people_bytes + state_bytes + max(people_bytes, result_bytes)
    if (mapped_bytes := rows * num_joints * num_views * _MAPPED) > _MIN_MAPPED:
        scratch_bytes += mapped_bytes
    return ForeseenSpace(round(output_bytes), round(result_bytes), round(scratch_bytes), num_people)


def _of_people(
    cameras: Sequence[CameraFrames], counted: Sequence[CameraFrames], num_frames: int, config: ReconstructionConfig
) -> tuple[int, int, float]:
    """Joints of a person, number of people, and cameras that see one of them at a time."""
    if counted:
        num_joints = max(camera.num_joints or _OF_ONE_NETWORK for camera in counted)
        bodies = [(camera.num_bodies or 0) / max(1, min(camera.num_frames, num_frames)) for camera in counted]
        num_people, num_views = max(1, round(max(bodies))), sum(bodies)
    else:
        num_joints = _NUM_JOINTS[config.detected_joints] if config.detector == "auto" else _OF_ONE_NETWORK
        num_people, num_views = _ASSUMED_PEOPLE, _ASSUMED_PEOPLE * _SEEING * len(cameras)
    views = min(len(cameras), num_views / num_people)
    return num_joints, min(num_people, config.num_people or num_people), views


def _detected(config: ReconstructionConfig, num_people: int, num_joints: int) -> float:
    """Bytes of what is detected in a frame of a video."""
    if config.uses_fields:
        return _FIELDS_OF_FRAME.get(config.detector, max(_FIELDS_OF_FRAME.values()))
    return _OF_FRAME + num_people * _SEEING * _DETECTION * (num_joints + 1.5)


def _export_bytes(
    exports: Iterable[Export], num_people: int, num_rows: float, num_joints: int, turns: float
) -> dict[Export, float]:
    sizes = {export: FILE_FORMATS[export].size for export in exports}
    return {
        export: num_people * size.of_file + num_rows * (turns * size.of_frame + num_joints * size.of_joint)
        for export, size in sizes.items()
    }


def _pictures(
    cameras: Sequence[CameraFrames],
    config: ReconstructionConfig,
    share: float,
    frame_rate_hz: float,
    num_rows: int,
    num_joints: int,
) -> float:
    num_bytes = 0.0
    for camera in cameras:
        num_frames = share * camera.num_frames
        if config.overlay:
            num_bytes += num_frames * _VIDEO_OF_PIXEL * _num_pixels(camera, _OVERLAY_SIDE_PX)
        if config.blurs_videos:
            num_bytes += camera.num_frames * _VIDEO_OF_PIXEL * _num_pixels(camera, _BLURRED_SIDE_PX)
        if "rerun" in config.exports:
            num_pictures = min(num_frames, num_frames / frame_rate_hz * _RECORDED_HZ)
            recorded = num_pictures * _PICTURE_OF_PIXEL * _num_pixels(camera, _RECORDED_SIDE_PX)
            num_bytes += min(recorded, _MAX_RECORDED_BYTES / len(cameras))
    if "rerun" in config.exports:
        num_bytes += num_rows * num_joints * _RECORDED_OF_JOINT
    if config.report:
        num_bytes += len(cameras) * _REPORT_OF_CAMERA + num_rows * _REPORT_OF_FRAME
    return num_bytes


def _num_pixels(camera: CameraFrames, long_side_px: int) -> float:
    """Pixels of a camera's picture that is made smaller, so that its long side fits."""
    width, height = camera.size_px
    scale = min(1.0, long_side_px / max(1, width, height))
    return scale**2 * width * height


CAMERA_FRAME_S: Mapping[tuple[Profile, JointsOfBody], float] = {
    ("fast", "body"): 0.023,
    ("fast", "feet"): 0.054,
    ("balanced", "feet"): 0.063,
    ("balanced", "whole"): 0.100,
    ("accurate", "feet"): 0.151,
}
"""Seconds of a job a camera's frame on one core, by profile and joints: docs/lab/measurements.md, "Profiles"."""

# Seconds of a unit of the sample on one core: two people before four cameras. Other stages take about the last one.
_UNIT_S = {
    stage.LOOK: 0.03,
    stage.CHECK: 0.08,
    stage.ASSOCIATE: 0.015,
    stage.EXPECT: 0.004,
    stage.REDETECT: 0.014,
    stage.FIT: 0.09,
    stage.HOLD: 0.02,
}
_OTHER_UNIT_S = 0.03


def unit_s(stage_name: str, config: ReconstructionConfig) -> float:
    """Seconds that a unit of a stage takes on one core.

    >>> unit_s("detect", ReconstructionConfig(profile="fast", joints="body"))
    0.023
    """
    if stage_name == stage.DETECT:
        return CAMERA_FRAME_S.get((config.profile, config.detected_joints), CAMERA_FRAME_S["balanced", "feet"])
    return _UNIT_S.get(stage_name, _OTHER_UNIT_S)
