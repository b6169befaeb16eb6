"""Plan of a job: stages, their tasks and the keys of the tasks' outputs. Standard library only.

A job reconstructs a session, makes a calibration from the board or the people that its videos show, makes proxies of
its videos, or rebuilds overlay videos, the report and the recording of a reconstruction.

``STAGES`` are the declarations of the modules of ``pipeline.run.steps``; progress, labels, keys, the page and the
command line read them. ``plan`` is pure: equal inputs give equal plans on every machine. The key of a task is a hash of
the stage, the digest of its code, the choices that it depends on, and the keys of its inputs down to the digests of the
session's files. Work that is planned again, after a crash or for another job, has the same keys, and its outputs are
found.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from importlib import import_module
from itertools import islice
from typing import Any

from pipeline.core.options.config import DEFAULT_CHUNK_FRAMES, ReconstructionConfig
from pipeline.core.options.edits import edit_document
from pipeline.core.options.file_formats import FILE_FORMATS
from pipeline.core.options.job_choices import ProxyChoices
from pipeline.run.engine.stage import IDENTIFY, SYNCHRONIZE, FrameCut, SessionFacts, Stage, Task

# Modules that declare the stages, in the order of their work.
_MODULES = (
    "detect",
    "calibrate",
    "proxy",
    "synchronize",
    "check",
    "refine",
    "cluster",
    "track",
    "redetect",
    "identify",
    "fit",
    "blur",
    "edit",
    "visuals",
    "character",
    "opensim",
    "export",
)
_STEPS = f"{__package__.rpartition('.')[0]}.steps"
STAGES: tuple[Stage, ...] = tuple(
    value
    for module in _MODULES
    for value in vars(import_module(f"{_STEPS}.{module}")).values()
    if isinstance(value, Stage)
)
"""All stages in their order."""

STAGE_BY_NAME: Mapping[str, Stage] = {stage.name: stage for stage in STAGES}

MAX_TASKS = 20_000
"""Largest number of tasks of a stage. Each is a row of the service's database, and a job is read from all its rows."""

# A frame of a task on the whole session takes about a tenth of the time of detecting people in it.
_FRAMES_A_UNIT = 10
# Choices that edits make; pieces do not depend on them.
_OF_EDITS = {"edits", "names"}
# Fields of the configuration on which no output depends.
_WITHOUT_EFFECT = {"chunk_frames", "processes", "is_remade"}


def interim_readers(stage: str) -> tuple[str, ...]:
    """Names of the stages that read interim outputs of a stage."""
    return tuple(other.name for other in STAGES if stage in other.interim_of)


@dataclass(frozen=True, slots=True)
class PlannedStage:
    """A stage of a plan: its tasks may run at once as soon as all tasks of the stage before it are done."""

    name: str  # Name of the stage
    # At least one; may be iterated more than once. There may be thousands, so they are derived one at a time.
    tasks: Iterable[Task]
    code_sha256: str  # Digest of the code that can run the tasks; see ``pipeline.run.engine.code``

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
    facts
        Facts of the session: digests of its inputs, output frames and their rate in Hz, stretches, cameras.
    config
        What to do. It decides which stages are planned, and its effective choices are part of the keys.
    codes
        Digest of each stage's code, by name of the stage; see ``pipeline.run.engine.code.stage_codes``.
    chunk_frames
        Output frames of a range. The frames between the start of a range and the keyframe before it are decoded in
        vain, so few long ranges of one camera are better than many short ones of all cameras. Ranges begin at its
        multiples, so jobs of a session cut alike. No key of a task on the whole session depends on it. It is doubled
        for a session that would have more than ``MAX_TASKS`` tasks in a stage.

    Returns
    -------
        The planned stages of ``STAGES``, in their order. Equal arguments give equal keys on every machine.

    Raises
    ------
    KeyError
        If ``codes`` lacks a stage.

    Examples
    --------
    >>> facts = SessionFacts((), 250, 25.0, (range(250),), {"left": 25.0, "right": 25.0}, has_videos=False)
    >>> stages = plan(facts, ReconstructionConfig(), dict.fromkeys(STAGE_BY_NAME, ""))
    >>> {stage.name: len(list(stage.tasks)) for stage in stages if stage.name in ("identify", "fit", "export")}
    {'identify': 1, 'fit': 4, 'export': 1}
    """
    whole = range(facts.num_frames)
    cut = FrameCut(config.frames or whole, facts.stretches, _bounded_length(facts, chunk_frames))
    # Cameras that were not synchronised took the wanted frames at other declared times.
    is_synchronized = STAGE_BY_NAME[SYNCHRONIZE].is_planned(facts, config) and not facts.has_points
    cut_by_camera = replace(cut, frames=whole) if is_synchronized else cut
    choices = effective_choices(config)
    keys: dict[str, str] = {}
    stages = []
    # People in 3D are found already.
    first = STAGES.index(STAGE_BY_NAME[IDENTIFY]) if facts.has_points else 0
    for stage in STAGES[first:]:
        if stage.is_planned(facts, config):
            inputs = [keys[name] for name in stage.follows if name in keys] or facts.inputs
            keys[stage.name] = _hash([stage.name, codes[stage.name], _stage_choices(stage, choices), inputs])
            own_cut = cut_by_camera if stage.cut == "camera ranges" else cut
            tasks = _tasks(stage, keys[stage.name], facts, own_cut, _cameras(facts, config))
            if stage.pieces_of:
                piece_key = _piece_key(STAGE_BY_NAME[stage.pieces_of], keys, codes, choices)
                tasks = tuple(replace(task, piece_key=piece_key) for task in tasks)
            stages.append(PlannedStage(stage.name, tasks, codes[stage.name]))
    return tuple(stages)


def _piece_key(stage: Stage, keys: Mapping[str, str], codes: Mapping[str, str], choices: Mapping[str, Any]) -> str:
    """Key of all that pieces of a stage's output depend on but the edits of people."""
    edit_stages = [other.name for other in STAGES if other.is_of_edits]
    before = [keys[name] for name in stage.follows if name in keys and name not in edit_stages]
    own = {name: value for name, value in _stage_choices(stage, choices).items() if name not in _OF_EDITS}
    return _hash([stage.name, codes[stage.name], own, before, [codes[name] for name in edit_stages]])


def _stage_choices(stage: Stage, choices: Mapping[str, Any]) -> dict[str, Any]:
    """Choices of a stage, and those that no stage names: they count for all, so that no output is reused wrongly."""
    named = {name for other in STAGES for name in other.choices}
    return {name: choices[name] for name in (*stage.choices, *(choices.keys() - named))}


def effective_choices(config: ReconstructionConfig) -> dict[str, Any]:
    """Choices as JSON, as far as outputs depend on them: ``None`` for a choice without effect.

    ``output`` stands for the kind of the detections, ``edits`` for who is where, and ``names`` for all edits if one of
    them names a person: a name changes no stage but those whose files hold names. ``poses`` tells whether the cameras
    have poses, which those that people calibrate have not.
    """
    is_clustering = config.method == "clustering"
    has_no_effect = {
        "profile": config.detector != "auto",
        "follow_s": config.uses_fields,
        "cutoff_hz": config.smoothing != "butterworth",
        "appearance": is_clustering,
        "joint_centers": config.smoothing != "fit",
        "preset": not any(FILE_FORMATS[export].has_presets for export in config.exports),
        "timeline": not config.exports and config.character is None,
        "body": not any(FILE_FORMATS[export].has_body for export in config.exports),
    }
    values = {choice.name: getattr(config, choice.name) for choice in fields(config)}
    edits, of_people = ([edit_document(edit) for edit in some] for some in (config.edits, config.people_edits))
    return {
        **{name: None if has_no_effect.get(name) else values[name] for name in values.keys() - _WITHOUT_EFFECT},
        "joints": None if config.detector != "auto" else config.detected_joints,
        "exports": sorted(config.exports),
        "making": None if config.making is None else asdict(config.making),
        "edits": of_people,
        "names": edits if edits != of_people else [],
        "tracking": None if is_clustering else dict(config.tracking),
        "clustering": dict(config.clustering) if is_clustering else None,
        "output": "fields" if config.uses_fields else "bodies",
        "poses": "known" if config.is_of_people else "unknown",
    }


def _bounded_length(facts: SessionFacts, chunk_frames: int) -> int:
    """Double the length of ranges until a stage has at most ``MAX_TASKS``; alike for all jobs of a session."""
    most = MAX_TASKS // max(1, len(facts.camera_rates_hz))
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
        wanted = cut.frames if "frame_range" in stage.choices else range(facts.num_frames)
        own_cut = replace(cut, frames=wanted)
        return _Derived(partial(_whole_camera_tasks, stage.name, stage_key, facts, own_cut, cameras, stage.max_frames))
    if stage.cut == "camera ranges":
        return _Derived(partial(_camera_tasks, stage.name, stage_key, facts, cut, stage.frames_a_unit))
    if stage.cut == "ranges":
        return _Derived(partial(_range_tasks, stage.name, stage_key, cut))
    num_units = -(-cut.num_frames // _FRAMES_A_UNIT)
    if stage.looked_at_hz is not None:
        num_units = max(1, min(cut.num_frames, round(stage.looked_at_hz * cut.num_frames / facts.frame_rate_hz)))
    if stage.cut == "people":
        num_parts = stage.num_parts(cut.frames)
        num_units = -(-num_units // num_parts)
        return tuple(
            Task(stage.name, index, None, cut.frames, cut.chunk_frames, num_units, _hash([stage_key, index]))
            for index in range(num_parts)
        )
    return (Task(stage.name, 0, None, cut.frames, cut.chunk_frames, num_units, stage_key),)


@dataclass(frozen=True, slots=True)
class _Derived:
    """Tasks that are derived again at each iteration."""

    derive: Callable[[], Iterator[Task]]

    def __iter__(self) -> Iterator[Task]:
        return self.derive()


def _whole_camera_tasks(
    stage: str, stage_key: str, facts: SessionFacts, cut: FrameCut, cameras: tuple[str, ...], max_frames: int | None
) -> Iterator[Task]:
    """Tasks on the frames of a camera each: the wanted ones if the stage depends on them, else the whole video."""
    frames = cut.frames
    for index, camera in enumerate(cameras):
        num_frames = max(1, round(len(frames) * facts.camera_rates_hz[camera] / facts.frame_rate_hz))
        num_units = min(max_frames or num_frames, num_frames)
        yield Task(stage, index, camera, frames, cut.chunk_frames, num_units, _hash([stage_key, camera]))


def _camera_tasks(stage: str, stage_key: str, facts: SessionFacts, cut: FrameCut, frames_a_unit: int) -> Iterator[Task]:
    """Tasks of a range of output frames and a camera each."""
    pieces = ((camera, frames) for frames in cut for camera in facts.camera_rates_hz)
    for index, (camera, frames) in enumerate(pieces):
        # About as many frames as the camera took meanwhile.
        num_frames = len(frames) * facts.camera_rates_hz[camera] / facts.frame_rate_hz
        num_units = max(1, round(num_frames / frames_a_unit))
        key = _hash([stage_key, camera, frames.start, frames.stop])
        yield Task(stage, index, camera, frames, cut.chunk_frames, num_units, key)


def _range_tasks(stage: str, stage_key: str, cut: FrameCut) -> Iterator[Task]:
    for index, frames in enumerate(cut):
        key = _hash([stage_key, frames.start, frames.stop])
        yield Task(stage, index, None, frames, cut.chunk_frames, len(frames), key)


def _hash(value: Sequence[Any]) -> str:
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(canonical.encode()).hexdigest()
