"""Plan of a job: stages, their tasks and the keys of the tasks' outputs. Standard library only.

A job reconstructs a session, makes a calibration from the board or the people that its videos show, makes proxies of
its videos, or makes overlay videos and the report of a reconstruction anew.

``STAGES`` declares each stage once; progress, labels, keys, the page and the command line read it. ``plan`` is pure:
equal inputs give equal plans on every machine. The key of a task is a hash of the stage, the digest of its code, the
choices that it depends on, and the keys of its inputs down to the digests of the session's files. Work that is planned
again, after a crash or for another job, has the same keys, and its outputs are found.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import islice
from typing import Any, Literal

from pipeline.calibration_choices import BOARD_FRAMES, CalibrationChoices
from pipeline.config import ReconstructionConfig, detected_joints, networks_of
from pipeline.edits import document_of, without_names
from pipeline.video.playback.choices import ProxyChoices

LOOK, DETECT, SYNCHRONIZE, REFINE = "look", "detect", "synchronize", "refine"
LENGTHS, POSES, ASSOCIATE = "lengths", "poses", "associate"
IDENTIFY, FIT, EDIT, REFIT = "identify", "fit", "edit", "refit"
WRITE, EXPORT = "write_people", "export"
OVERLAY, REPORT = "draw_overlay", "write_report"
FIND_BOARD, CALIBRATE, PROXY = "find_board", "make_calibration", "make_proxy"
CHECK = "check_session"

DEFAULT_CHUNK_FRAMES = ReconstructionConfig().chunk_frames
MAX_TASKS = 20_000
"""Largest number of tasks of a stage. Each is a row of the service's database, and a job is read from all its rows."""

PERSON_PARTS = 4
"""Number of tasks of a stage that is cut by person: person number k is in task k modulo this number.

A plan is made before anybody is found. Tasks without a person take a tenth of a second.
"""

LOOKED_AT_FRAMES = 12
"""Largest number of frames of a camera that the stage ``look`` decodes."""

# A frame of a task on the whole session takes about a tenth of the time of detecting people in it.
_FRAMES_A_UNIT = 10
# Rate of the frames in which clustering measures bones.
_MEASURED_HZ = 5
# Stages that keep pieces of their outputs for other edits, with the stage on whose code and choices the pieces depend.
_PIECES_OF = {REFIT: REFIT, WRITE: EXPORT, EXPORT: EXPORT}
# Choices that edits make; pieces do not depend on them.
_OF_EDITS = {"edits", "names"}
# Fields of the configuration on which no output depends.
_WITHOUT_EFFECT = {"chunk_frames", "processes"}

Cut = Literal["cameras", "camera ranges", "ranges", "people", "whole"]


@dataclass(frozen=True, slots=True)
class SessionFacts:
    """Facts of a session that a plan depends on.

    Parameters
    ----------
    inputs
        Digests of the files, and of all that was found in them or stated about them.
    num_frames, frame_rate_hz
        Output frames of the session, and their rate.
    stretches
        Output frames in which a camera took frames, ascending; pauses lie between them.
    camera_rates_hz
        Frame rate of each camera, by name, in the session's order.
    has_videos
        Whether the session consists of videos; else of keypoints.
    """

    inputs: tuple[str, ...]
    num_frames: int
    frame_rate_hz: float
    stretches: tuple[range, ...]
    camera_rates_hz: Mapping[str, float]
    has_videos: bool


@dataclass(frozen=True, slots=True)
class FrameCut:
    """Cut of a session's output frames into ranges.

    Parameters
    ----------
    frames
        Wanted output frames.
    stretches
        Output frames of the session that have to be worked on, ascending; ranges without any of them are left out.
    chunk_frames
        Length of a range. Ranges begin at its multiples; the first and the last one may be shorter.
    """

    frames: range
    stretches: tuple[range, ...]
    chunk_frames: int

    def __iter__(self) -> Iterator[range]:
        """Ranges in order, at least one."""
        stop = 0
        for part in self.parts:
            first = max(stop, part.start // self.chunk_frames)
            stop = -(-part.stop // self.chunk_frames)
            for number in range(first, stop):
                start = number * self.chunk_frames
                yield range(max(start, self.frames.start), min(start + self.chunk_frames, self.frames.stop))

    @property
    def num_frames(self) -> int:
        """Number of frames of all parts."""
        return sum(map(len, self.parts))

    @property
    def parts(self) -> list[range]:
        """Stretches within the wanted frames; the first wanted frame if there are none."""
        inside = (range(max(one.start, self.frames.start), min(one.stop, self.frames.stop)) for one in self.stretches)
        return [part for part in inside if part] or [self.frames[:1]]


@dataclass(frozen=True, slots=True)
class Stage:
    """Declaration of a stage.

    Parameters
    ----------
    name
        Name in the service's API, in keys and in logs.
    label
        What forms and progress bars call it.
    cut
        How it is cut into tasks: by camera, by camera and range of frames, by range of frames, by person, or not at
        all.
    follows
        Stages whose outputs it reads, as far as they are planned; the others in the plan before it must be done too.
    choices
        Keys of ``effective_choices`` on which its output depends. All stages depend on a choice that no stage names.
    function
        Name of its function in ``pipeline.stages.run``.
    is_planned
        Whether a job has this stage.
    unit
        What its progress counts.
    is_reusable
        Whether its outputs serve other jobs of the session too.
    leaves_interim
        Whether its tasks leave interim outputs beside their outputs: for the stages of the same job that follow it,
        removed when the job ends. An interim output belongs to no key. A task whose output is reused runs all the same
        if its interim output is missing and an output of a stage that follows is missing too.
    """

    name: str
    label: str
    cut: Cut
    follows: tuple[str, ...]
    choices: tuple[str, ...]
    function: str
    is_planned: Callable[[SessionFacts, ReconstructionConfig], bool] = lambda facts, config: config.is_of_people
    unit: Literal["frames", "steps"] = "steps"
    is_reusable: bool = True
    leaves_interim: Callable[[ReconstructionConfig], bool] = lambda config: False


def _is_detecting(facts: SessionFacts, config: ReconstructionConfig) -> bool:
    making = config.making
    is_wanted = config.is_of_people or (isinstance(making, CalibrationChoices) and making.board is None)
    return facts.has_videos and is_wanted


def _is_sized(facts: SessionFacts, config: ReconstructionConfig) -> bool:
    return _is_detecting(facts, config) and networks_of(config).is_sized


def _is_finding_board(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return isinstance(config.making, CalibrationChoices) and config.making.board is not None


def _is_calibrating(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return isinstance(config.making, CalibrationChoices)


def _is_making_proxies(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return isinstance(config.making, ProxyChoices)


def _is_clustering(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return config.is_of_people and config.method == "clustering"


def _is_refining(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return config.is_of_people and config.refine_calibration == "auto"


def _is_edited(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return config.is_of_people and bool(without_names(config.edits))


def _is_exporting(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return config.making is None


def _is_exporting_edited(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return config.making is None and bool(without_names(config.edits))


def _is_overlaid(facts: SessionFacts, config: ReconstructionConfig) -> bool:
    return config.is_of_people and config.overlay and facts.has_videos


def _is_reported(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return config.is_of_people and config.report


def _is_synchronizing(_: SessionFacts, config: ReconstructionConfig) -> bool:
    return config.is_of_people and config.sync == "auto"


STAGES = (
    Stage(
        LOOK,
        "Look at people",
        cut="cameras",
        follows=(),
        choices=("profile", "detector"),
        function="look",
        is_planned=_is_sized,
        unit="frames",
    ),
    Stage(
        DETECT,
        "Detect 2D joints",
        cut="camera ranges",
        follows=(LOOK,),
        choices=("profile", "joints", "detector", "output"),
        function="detect",
        is_planned=_is_detecting,
        unit="frames",
        leaves_interim=lambda config: config.uses_colours,
    ),
    Stage(
        FIND_BOARD,
        "Find the board",
        cut="cameras",
        follows=(),
        choices=("making",),
        function="find_board",
        is_planned=_is_finding_board,
        unit="frames",
    ),
    Stage(
        CALIBRATE,
        "Calibrate cameras",
        cut="whole",
        follows=(DETECT, FIND_BOARD),
        choices=("making",),
        function="calibrate",
        is_planned=_is_calibrating,
        is_reusable=False,
    ),
    Stage(
        PROXY,
        "Convert videos for browsers",
        cut="cameras",
        follows=(),
        choices=("making",),
        function="make_proxy",
        is_planned=_is_making_proxies,
        unit="frames",
        is_reusable=False,
    ),
    Stage(
        SYNCHRONIZE,
        "Synchronise cameras",
        cut="whole",
        follows=(DETECT,),
        choices=("sync",),
        function="synchronize_cameras",
        is_planned=_is_synchronizing,
    ),
    Stage(
        CHECK,
        "Check the session",
        cut="whole",
        follows=(DETECT, SYNCHRONIZE),
        choices=("frame_range",),
        function="check_people_of_session",
    ),
    Stage(
        REFINE,
        "Refine calibration",
        cut="whole",
        follows=(DETECT, SYNCHRONIZE),
        choices=("refine_calibration", "method", "frame_range", "tracking", "clustering"),
        function="refine_calibration",
        is_planned=_is_refining,
    ),
    Stage(
        LENGTHS,
        "Measure bones",
        cut="whole",
        follows=(DETECT, SYNCHRONIZE, REFINE),
        choices=("frame_range", "clustering"),
        function="measure_lengths",
        is_planned=_is_clustering,
    ),
    Stage(
        POSES,
        "Find people",
        cut="ranges",
        follows=(DETECT, SYNCHRONIZE, REFINE, LENGTHS),
        choices=("frame_range", "clustering"),
        function="find_poses",
        is_planned=_is_clustering,
    ),
    Stage(
        ASSOCIATE,
        "Track people",
        cut="whole",
        follows=(DETECT, SYNCHRONIZE, REFINE, LENGTHS, POSES),
        choices=("method", "frame_range", "appearance", "tracking", "clustering"),
        function="associate_people",
    ),
    Stage(
        IDENTIFY,
        "Tell people apart",
        cut="whole",
        follows=(DETECT, SYNCHRONIZE, REFINE, ASSOCIATE),
        choices=("people",),
        function="identify_people",
    ),
    Stage(
        FIT,
        "Fit skeletons",
        cut="whole",
        follows=(SYNCHRONIZE, REFINE, IDENTIFY),
        choices=("smoothing", "cutoff_hz", "feet", "joint_centers"),
        function="fit_skeletons",
    ),
    Stage(
        EDIT,
        "Edit people",
        cut="whole",
        follows=(SYNCHRONIZE, IDENTIFY),
        choices=("edits",),
        function="edit_people",
        is_planned=_is_edited,
    ),
    Stage(
        REFIT,
        "Fit edited people",
        cut="people",
        follows=(SYNCHRONIZE, REFINE, IDENTIFY, FIT, EDIT),
        choices=("smoothing", "cutoff_hz", "feet", "joint_centers"),
        function="refit_skeletons",
        is_planned=_is_edited,
    ),
    Stage(
        OVERLAY,
        "Draw overlay videos",
        cut="cameras",
        follows=(SYNCHRONIZE, REFINE, IDENTIFY, FIT, EDIT, REFIT),
        choices=("overlay", "frame_range", "names"),
        function="draw_overlay",
        is_planned=_is_overlaid,
        unit="frames",
        is_reusable=False,
    ),
    Stage(
        REPORT,
        "Write the report",
        cut="whole",
        follows=(CHECK, SYNCHRONIZE, REFINE, IDENTIFY, FIT, EDIT, REFIT),
        choices=("report", "names"),
        function="write_report",
        is_planned=_is_reported,
        is_reusable=False,
    ),
    Stage(
        WRITE,
        "Write files of edited people",
        cut="people",
        follows=(CHECK, SYNCHRONIZE, REFINE, IDENTIFY, FIT, EDIT, REFIT),
        choices=("exports", "bvh", "output_rate_hz"),
        function="write_people_of_part",
        is_planned=_is_exporting_edited,
    ),
    Stage(
        EXPORT,
        "Write files",
        cut="whole",
        follows=(CHECK, SYNCHRONIZE, REFINE, IDENTIFY, FIT, EDIT, REFIT, WRITE),
        choices=("exports", "bvh", "output_rate_hz", "names"),
        function="export",
        is_planned=_is_exporting,
        is_reusable=False,
    ),
)
"""All stages in their order."""

STAGE_BY_NAME: Mapping[str, Stage] = {stage.name: stage for stage in STAGES}


def followers(stage: str) -> tuple[str, ...]:
    """Names of the stages that read outputs of a stage."""
    return tuple(other.name for other in STAGES if stage in other.follows)


@dataclass(frozen=True, slots=True)
class Task:
    """A task of a stage.

    Parameters
    ----------
    stage
        Name of the stage.
    index
        Number within the stage.
    camera
        Camera whose frames it is about; ``None``: all cameras.
    frames
        Output frames, in the session's numbering.
    chunk_frames
        Length of the ranges into which the session's frames are cut.
    num_units
        Number of units that its progress counts, at least 1.
    key
        Content-addressed key of its output.
    piece_key
        Key of all that pieces of its output depend on but the edits of people, for stages that follow edits; see
        ``pipeline.stages.results.pieces``.
    """

    stage: str
    index: int
    camera: str | None
    frames: range
    chunk_frames: int
    num_units: int
    key: str
    piece_key: str = ""


@dataclass(frozen=True, slots=True)
class PlannedStage:
    """A stage of a plan: its tasks may run at once as soon as all tasks of the stage before it are done.

    Parameters
    ----------
    name
        Name of the stage.
    tasks
        At least one; may be iterated more than once. There may be thousands, so they are derived one at a time.
    code_sha256
        Digest of the code that can run the tasks; see ``pipeline.stages.code``.
    """

    name: str
    tasks: Iterable[Task]
    code_sha256: str

    @property
    def num_units(self) -> int:
        """Units of all tasks."""
        return sum(task.num_units for task in self.tasks)


def plan(
    facts: SessionFacts,
    config: ReconstructionConfig,
    codes: Mapping[str, str],
    chunk_frames: int = DEFAULT_CHUNK_FRAMES,
) -> tuple[PlannedStage, ...]:
    """Cut a job into stages and tasks.

    Parameters
    ----------
    facts, config
        The session, and what to do with it.
    codes
        Digest of each stage's code, by name of the stage; see ``pipeline.stages.code.stage_codes``.
    chunk_frames
        Output frames of a range. The frames between the start of a range and the keyframe before it are decoded in
        vain, so few long ranges of one camera are better than many short ones of all cameras. Ranges begin at its
        multiples, so jobs of a session cut alike. No key of a task on the whole session depends on it. It is doubled
        for a session that would have more than ``MAX_TASKS`` tasks in a stage.

    Returns
    -------
        The planned stages of ``STAGES``, in their order.
    """
    whole = range(facts.num_frames)
    cut = FrameCut(config.frames or whole, facts.stretches, _bounded_length(facts, chunk_frames))
    # Cameras that were not synchronised took the wanted frames at other declared times.
    cut_by_camera = replace(cut, frames=whole) if _is_synchronizing(facts, config) else cut
    choices = effective_choices(config)
    unassigned = _unassigned(choices)
    keys: dict[str, str] = {}
    stages = []
    for stage in STAGES:
        if stage.is_planned(facts, config):
            inputs = [keys[name] for name in stage.follows if name in keys] or facts.inputs
            own = {name: choices[name] for name in (*stage.choices, *unassigned)}
            keys[stage.name] = _hash([stage.name, codes[stage.name], own, inputs])
            of_stage = cut_by_camera if stage.cut == "camera ranges" else cut
            tasks = _tasks(stage, keys[stage.name], facts, of_stage, _cameras(facts, config))
            if stage.name in _PIECES_OF:
                piece_key = _piece_key(STAGE_BY_NAME[_PIECES_OF[stage.name]], keys, codes, choices)
                tasks = tuple(replace(task, piece_key=piece_key) for task in tasks)
            stages.append(PlannedStage(stage.name, tasks, codes[stage.name]))
    return tuple(stages)


def _piece_key(stage: Stage, keys: Mapping[str, str], codes: Mapping[str, str], choices: Mapping[str, Any]) -> str:
    """Key of all that pieces of a stage's output depend on but the edits of people."""
    after_edits = {EDIT, REFIT, WRITE}
    own = {name: choices[name] for name in (*stage.choices, *_unassigned(choices)) if name not in _OF_EDITS}
    before = [keys[name] for name in stage.follows if name in keys and name not in after_edits]
    return _hash([stage.name, codes[stage.name], own, before, [codes[name] for name in (EDIT, REFIT)]])


def _unassigned(choices: Mapping[str, Any]) -> set[str]:
    """Choices that no stage names: they count for all stages, so that no output of another choice is ever reused."""
    return choices.keys() - {name for stage in STAGES for name in stage.choices}


def effective_choices(config: ReconstructionConfig) -> dict[str, Any]:
    """Choices as JSON, as far as outputs depend on them: ``None`` for a choice without effect.

    ``output`` stands for the kind of the detections, ``edits`` for who is where, and ``names`` for all edits if one of
    them names somebody: a name changes no stage but those whose files hold names.
    """
    is_clustering = config.method == "clustering"
    has_no_effect = {
        "profile": config.detector != "auto",
        "cutoff_hz": config.smoothing != "butterworth",
        "appearance": is_clustering,
        "joint_centers": config.smoothing != "fit",
        "bvh": "bvh" not in config.exports,
    }
    values = {choice.name: getattr(config, choice.name) for choice in fields(config)}
    edits, of_people = ([document_of(edit) for edit in some] for some in (config.edits, without_names(config.edits)))
    return {
        **{name: None if has_no_effect.get(name) else values[name] for name in values.keys() - _WITHOUT_EFFECT},
        "joints": None if config.detector != "auto" else detected_joints(config),
        "exports": sorted(config.exports),
        "making": None if config.making is None else asdict(config.making),
        "edits": of_people,
        "names": edits if edits != of_people else [],
        "tracking": None if is_clustering else dict(config.tracking),
        "clustering": dict(config.clustering) if is_clustering else None,
        "output": "fields" if config.uses_fields else "bodies",
    }


def _bounded_length(facts: SessionFacts, chunk_frames: int) -> int:
    """Double the length of ranges until a stage has at most ``MAX_TASKS``; alike for all jobs of a session."""
    most = max(1, MAX_TASKS // len(facts.camera_rates_hz))
    whole = range(facts.num_frames)
    while sum(1 for _ in islice(FrameCut(whole, facts.stretches, chunk_frames), most + 1)) > most:
        chunk_frames *= 2
    return chunk_frames


def _cameras(facts: SessionFacts, config: ReconstructionConfig) -> tuple[str, ...]:
    """Cameras of the stages that are cut by camera."""
    chosen = config.making.cameras if isinstance(config.making, ProxyChoices) else facts.camera_rates_hz
    return tuple(camera for camera in facts.camera_rates_hz if camera in chosen)


def _tasks(
    stage: Stage, stage_key: str, facts: SessionFacts, cut: FrameCut, cameras: tuple[str, ...]
) -> Iterable[Task]:
    if stage.cut == "cameras":
        frames = cut.frames if "frame_range" in stage.choices else range(facts.num_frames)
        return _WholeCameraTasks(stage.name, stage_key, facts, cameras, cut.chunk_frames, frames)
    if stage.cut == "camera ranges":
        return _CameraTasks(stage.name, stage_key, cut, facts.frame_rate_hz, facts.camera_rates_hz)
    if stage.cut == "ranges":
        return _RangeTasks(stage.name, stage_key, cut)
    num_units = -(-cut.num_frames // _FRAMES_A_UNIT)
    if stage.name == LENGTHS:
        num_units = max(1, min(cut.num_frames, round(_MEASURED_HZ * cut.num_frames / facts.frame_rate_hz)))
    if stage.cut == "people":
        num_units = -(-num_units // PERSON_PARTS)
        return tuple(
            Task(stage.name, index, None, cut.frames, cut.chunk_frames, num_units, _hash([stage_key, index]))
            for index in range(PERSON_PARTS)
        )
    return (Task(stage.name, 0, None, cut.frames, cut.chunk_frames, num_units, stage_key),)


@dataclass(frozen=True, slots=True)
class _WholeCameraTasks:
    """Tasks of a stage on each camera's video: the wanted frames if the stage depends on them, else the whole video."""

    stage: str
    stage_key: str
    facts: SessionFacts
    cameras: tuple[str, ...]
    chunk_frames: int
    frames: range

    def __iter__(self) -> Iterator[Task]:
        frames = self.frames
        for index, camera in enumerate(self.cameras):
            rate_hz = self.facts.camera_rates_hz[camera]
            num_frames = max(1, round(len(frames) * rate_hz / self.facts.frame_rate_hz))
            most = {LOOK: LOOKED_AT_FRAMES, FIND_BOARD: BOARD_FRAMES}.get(self.stage, num_frames)
            num_units = min(most, num_frames)
            key = _hash([self.stage_key, camera])
            yield Task(self.stage, index, camera, frames, self.chunk_frames, num_units, key)


@dataclass(frozen=True, slots=True)
class _CameraTasks:
    """Tasks of a stage that is cut by range of output frames and camera."""

    stage: str
    stage_key: str
    cut: FrameCut
    frame_rate_hz: float
    camera_rates_hz: Mapping[str, float]

    def __iter__(self) -> Iterator[Task]:
        pieces = ((camera, frames) for frames in self.cut for camera in self.camera_rates_hz)
        for index, (camera, frames) in enumerate(pieces):
            # About as many frames as the camera took meanwhile.
            num_units = max(1, round(len(frames) * self.camera_rates_hz[camera] / self.frame_rate_hz))
            key = _hash([self.stage_key, camera, frames.start, frames.stop])
            yield Task(self.stage, index, camera, frames, self.cut.chunk_frames, num_units, key)


@dataclass(frozen=True, slots=True)
class _RangeTasks:
    """Tasks of a stage that is cut by range of output frames."""

    stage: str
    stage_key: str
    cut: FrameCut

    def __iter__(self) -> Iterator[Task]:
        for index, frames in enumerate(self.cut):
            key = _hash([self.stage_key, frames.start, frames.stop])
            yield Task(self.stage, index, None, frames, self.cut.chunk_frames, len(frames), key)


def _hash(value: Sequence[Any]) -> str:
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(canonical.encode()).hexdigest()
