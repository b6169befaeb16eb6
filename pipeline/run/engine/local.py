"""Executor of one machine: the tasks of a plan in this process, or in a pool of processes."""

import contextlib
import json
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pipeline.capture.points import PointSession
from pipeline.capture.preflight_npz import record_sha256
from pipeline.capture.session import CaptureSession, Session
from pipeline.core.data.detections import Detections
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.arguments import checked
from pipeline.core.options.config import ReconstructionConfig, method_warnings
from pipeline.core.options.file_formats import FILE_FORMATS
from pipeline.core.options.job_choices import CalibrationChoices
from pipeline.core.options.rules import config_problems, require
from pipeline.core.paths import StrPath
from pipeline.core.progress import OnProgress, silent
from pipeline.detection.bodies import concatenate
from pipeline.detection.entries import detection_joints
from pipeline.detection.providers.find import current_provider
from pipeline.export.character.source import CharacterSource
from pipeline.export.results import OnFile, WrittenResults, no_file
from pipeline.motion.body.installed import load as load_body
from pipeline.run.engine.code import stage_codes
from pipeline.run.engine.local_tasks import FilesDestination, LocalJob, TaskPool, file_digest, run_stage, scratch_folder
from pipeline.run.engine.methods import clustering_parameters, tracking_parameters
from pipeline.run.engine.output_folder import OutputFolder, output_folder
from pipeline.run.engine.plan import STAGE_BY_NAME, STAGES, plan
from pipeline.run.engine.stage import DETECT, EXPORT, LOOK, WRITE, SessionFacts
from pipeline.run.engine.take import assemble
from pipeline.run.session_check.verdict import require_cameras
from pipeline.video.frame_rate import measured_rate_hz

_DEFAULTS = ReconstructionConfig()
_STAGES_OF_RECORDS = {stage.name for stage in STAGES if not stage.makes_files} - {WRITE}


@checked
def reconstruct(
    session: Session,
    config: ReconstructionConfig = _DEFAULTS,
    on_progress: OnProgress = silent,
    cache: StrPath | None = None,
) -> Reconstruction:
    """Reconstruct everybody in a capture session; write no file.

    The result does not depend on the cut of the frames or on the number of processes.

    Parameters
    ----------
    session
        Calibrated cameras with their videos, or with 2D joints of another program.
    config
        What to do; a session of keypoints has nothing to detect.
    on_progress
        Called after every unit of a stage, from the calling thread.
    cache
        Folder in which outputs of tasks are kept for later runs; ``None``: no output is kept.

    Returns
    -------
    Reconstruction
        Tracks in metres, NaN where a joint is unknown, and motions of skeletons.

    Raises
    ------
    InputError
        If a video can't be decoded, too many of its frames are damaged, or the configuration breaks a rule.
    SessionRefused
        If the check of the session finds errors, unless ``config.force``.
    ModelError
        If the detector is not installed.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> take = multicap.reconstruct(session, multicap.ReconstructionConfig(refine_calibration="off"))
    >>> take.timebase.num_frames == session.timebase.num_frames
    True
    """
    _check(session, config)
    cache = None if cache is None else Path(cache)
    facts = session_facts(session, () if cache is None else _inputs(session))
    with _planned(session, config, facts, _STAGES_OF_RECORDS, cache) as job:
        for stage in job.stages:
            run_stage(job, stage, on_progress)
        reconstruction = assemble(job.context())
        return replace(
            reconstruction,
            # The files of the block are gone after it.
            located=tuple(reconstruction.located),
            observations=tuple(reconstruction.observations),
            warnings=(*reconstruction.warnings, *method_warnings(config, facts.has_videos)),
        )


@checked
def reconstruct_to_files(
    session: Session,
    folder: StrPath,
    config: ReconstructionConfig = _DEFAULTS,
    on_progress: OnProgress = silent,
    cache: StrPath | None = None,
    name: str = "",
    sources: Sequence[StrPath] = (),
    on_file: OnFile = no_file,
    character: CharacterSource | None = None,
) -> WrittenResults:
    """Reconstruct all people in a capture session, and write the result files, like the service.

    Parameters
    ----------
    session, config, on_progress, cache
        See ``reconstruct``. ``config`` names the files.
    folder
        Folder of the result files, made if it is missing.
    name
        Name of the take in its report; by default the folder's name.
    sources
        Files that the report names with their digests beside the videos, such as the calibration.
    on_file
        Called with the path of each file when it is whole and has its name.
    character
        Character onto which all people are retargeted as well; ``None``: there is none.

    Returns
    -------
    WrittenResults
        Paths of the files, and the content of ``metrics.json``.

    Raises
    ------
    InputError, ModelError
        See ``reconstruct``; and if the character, or the human body, can't be used.
    PipelineError
        If a folder can't be written to, the disk is full, or the content of a file differs from the written content.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> config = multicap.ReconstructionConfig(exports=("trc",))
    >>> written = multicap.reconstruct_to_files(session, folder / "results", config)
    >>> "metrics.json" in {path.name for path in written.paths}
    True
    """
    _check(session, config)
    if config.body == "human" and any(FILE_FORMATS[export].has_body for export in config.exports):
        load_body()
    if character is not None:
        character.open()
        config = replace(config, character=character.sha256)
    folder, cache = Path(folder), None if cache is None else Path(cache)
    facts = session_facts(session, () if cache is None else _inputs(session))
    files = FilesDestination(folder, name or folder.resolve().name or "take", tuple(map(Path, sources)), character)
    paths: list[Path] = []
    with _planned(session, config, facts, STAGE_BY_NAME.keys(), cache, files) as job:
        for stage in job.stages:
            for path in run_stage(job, stage, on_progress):
                paths.append(path)
                on_file(path)
        (exported,) = job.context().outputs(EXPORT)
        return WrittenResults(tuple(paths), json.loads(exported)["metrics"])


def detect_people(
    session: CaptureSession,
    config: ReconstructionConfig = _DEFAULTS,
    on_progress: OnProgress = silent,
    has_poses: bool = True,
) -> Mapping[str, Detections]:
    """Detect bodies in all videos of a session.

    - ``session``: cameras with their videos.
    - ``has_poses``: whether the cameras have poses in a world with Z up, which tell how they hang; else people alone
      do.
    - Raises ``InputError`` if a video can't be decoded or too many of its frames are damaged.
    - Raises ``ModelError`` if the detector is not installed.
    - Returns bodies by camera, with the joints of ``detection_joints``.
    """
    making = None if has_poses else CalibrationChoices(board=None)
    config = replace(config, method="tracking", appearance="off", making=making)
    with _planned(session, config, session_facts(session), {LOOK, DETECT}, None) as job:
        for stage in job.stages:
            run_stage(job, stage, on_progress)
        chunks = job.context().records(DETECT, Detections)
        names = [camera.name for camera in session.cameras]
        return concatenate(chunks, names, len(detection_joints(config).names))


@contextlib.contextmanager
def _planned(
    session: Session,
    config: ReconstructionConfig,
    facts: SessionFacts,
    wanted: Collection[str],
    cache: Path | None,
    files: "FilesDestination | None" = None,
) -> Iterator["LocalJob"]:
    """Plan the wanted stages of a job, with the folders of their outputs for the block."""
    with contextlib.ExitStack() as stack:
        outputs = stack.enter_context(output_folder(cache))
        interim = stack.enter_context(tempfile.TemporaryDirectory(prefix="multicap-"))
        scratch = stack.enter_context(scratch_folder(None if files is None else files.folder))
        codes = dict.fromkeys(STAGE_BY_NAME, "") if cache is None else stage_codes(current_provider().identity)
        stages = [stage for stage in plan(facts, config, codes, config.chunk_frames) if stage.name in wanted]
        kept = OutputFolder(Path(interim))
        yield LocalJob(session, config, facts, stages, outputs, kept, scratch, files, TaskPool(stack))


def session_facts(session: Session, inputs: tuple[str, ...] = ()) -> SessionFacts:
    """Facts of an opened session that a plan depends on."""
    timebase = session.timebase
    return SessionFacts(
        inputs=inputs,
        num_frames=timebase.num_frames,
        frame_rate_hz=timebase.frame_rate_hz,
        stretches=session.stretches,
        camera_rates_hz={
            name: measured_rate_hz(times.time_s) if len(times.time_s) > 1 else timebase.frame_rate_hz
            for name, times in session.times.items()
        },
        has_videos=bool(session.camera_videos),
        has_points=isinstance(session, PointSession),
    )


def _inputs(session: Session) -> tuple[str, ...]:
    """Digests of all that the result depends on: the opened session, and the videos' files."""
    paths = (path for video in session.camera_videos.values() for path in video.paths)
    return (record_sha256(session), *map(file_digest, paths))


def _check(session: Session, config: ReconstructionConfig) -> None:
    """Find out what is wrong before the work begins."""
    require(config_problems(config, session.timebase.num_frames, session.timebase.frame_rate_hz))
    if isinstance(session, PointSession):
        return
    require_cameras(session.cameras, config)
    wanted = session.restricted(config.frames)
    tracking_parameters(wanted.cameras, wanted.timebase, config.tracking)
    clustering_parameters(wanted.cameras, config, config.uses_fields and bool(wanted.camera_videos))
