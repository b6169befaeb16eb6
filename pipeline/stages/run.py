"""Functions of the stages: the only code that knows what a task does.

``run_task`` is called by the executor of one machine, ``pipeline.stages.local``, and by the workers of the service.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from pipeline.calibration.board.calibrate import calibrate_board
from pipeline.calibration.board.source import frames_to_look_at, look_in_video, photographs_to_look_at
from pipeline.calibration.board.spec import parse_board
from pipeline.calibration.board.views import BoardViews
from pipeline.calibration.people.calibrate import calibrate_people
from pipeline.calibration.report import CalibrationResult, report_document
from pipeline.calibration.write import encodings
from pipeline.calibration_choices import CalibrationChoices
from pipeline.capture.keypoints import KeypointSession
from pipeline.config import FILE_FORMATS, detected_joints, networks_of
from pipeline.data import Animation, Detections, PictureChanges, Poses3D, no_colours
from pipeline.detect.chunk import detect_chunk, detect_fields_chunk, measure_colours
from pipeline.detect.damage import DamagedFrames, damaged_videos
from pipeline.detect.profiles.detection import load_detector, open_detection
from pipeline.detect.profiles.look import look_at_people
from pipeline.detect.profiles.sizes import RULES, CameraSizes
from pipeline.errors import InputError, PipelineError, Problem, listed
from pipeline.export.results import NOTHING_KEPT, ReportOf, keep_people, write_files
from pipeline.findings import Finding
from pipeline.hands.attach import has_hands, without_fingers
from pipeline.joints import without_hands
from pipeline.progress import OnShare, in_units
from pipeline.quality.report import all_checks, quality_report
from pipeline.quality.views import views_of
from pipeline.runtime.npz import encode_arrays
from pipeline.skeleton.animate import animate
from pipeline.stages.association import (
    DetectionsByCamera,
    MeasuredBones,
    assign_identities,
    attach,
    link,
    locate_people,
    measure_bones,
    track,
)
from pipeline.stages.cameras.checking import check_bodies, check_session, with_clocks
from pipeline.stages.cameras.refinement import refine_from_bodies, refine_from_fields
from pipeline.stages.cameras.synchronization import listen, measure_clocks, on_measured_clocks
from pipeline.stages.codec import decode, encode
from pipeline.stages.editing import changed_people, edited_take
from pipeline.stages.inputs import (
    PEOPLE,
    Context,
    all_bodies,
    archive_of_people,
    detected_bodies,
    detected_in,
    detection_joints,
    from_first,
    gathered_bodies,
    measured_clocks,
    measured_frames,
    on_clocks,
    used_offsets,
    wanted_inputs,
)
from pipeline.stages.output import Output, ResultFile
from pipeline.stages.people import StoredPeople, write_people
from pipeline.stages.plan import (
    ASSOCIATE,
    FIND_BOARD,
    IDENTIFY,
    LENGTHS,
    LOOK,
    LOOKED_AT_FRAMES,
    PERSON_PARTS,
    POSES,
    STAGE_BY_NAME,
    FrameCut,
    Task,
)
from pipeline.stages.results.assembly import EDITED, assemble, kept_frames, spans_found
from pipeline.stages.results.kept_files import FilesInPieces, TakeInPieces
from pipeline.stages.results.overlay import overlay_file
from pipeline.stages.results.pieces import Pieces
from pipeline.stages.results.refit import refit
from pipeline.stages.results.report import report_file
from pipeline.stages.viewer import viewer_files
from pipeline.synchronization.sound.offsets import SoundOffsets
from pipeline.video.playback.choices import PROXY_KIND, proxy_name
from pipeline.video.playback.proxy_process import make_proxy_in_child
from pipeline.video.timeline import span_s

_MEDIA_TYPES = {".json": "application/json", ".svg": "image/svg+xml"} | {
    f".{name}": file_format.media_type for name, file_format in FILE_FORMATS.items()
}


def run_task(task: Task, context: Context) -> Output:
    """Run a task.

    Parameters
    ----------
    task
        A task of ``pipeline.stages.plan.plan``. All tasks of the stages before it are done.
    context
        Its session, and the outputs of the stages before it.

    Raises
    ------
    InputError
        If a video can't be decoded or too many of its frames are damaged.
    ModelError
        If the detector is not installed.
    PipelineError
        If a result file is not whole when it is read back.
    """
    return _FUNCTIONS[STAGE_BY_NAME[task.stage].function](task, context)


def look(task: Task, context: Context) -> Output:
    """Look at the people in some frames of a camera's whole video, and choose the size of its images."""
    session = context.session()
    if isinstance(session, KeypointSession) or task.camera is None:
        raise PipelineError("A session of keypoints has no videos.")
    detector = load_detector(networks_of(context.config).body)
    rule = RULES[context.config.profile]
    with context.video(task.camera):
        sizes = look_at_people(session, task.camera, detector, rule, LOOKED_AT_FRAMES, context.on_unit)
    return Output(encode(sizes))


def detect(task: Task, context: Context) -> Output:
    """Find bodies in a range of a camera's frames, or the peaks and fields that clustering takes.

    The colours of the bodies are an interim output. If nothing else is missing, they are measured without the network.
    """
    session = context.session()
    if isinstance(session, KeypointSession) or task.camera is None:
        raise PipelineError("A session of keypoints has no videos.")
    span = span_s(session.timebase, task.frames.start, task.frames.stop)
    config, found = context.config, context.found()
    with context.video(task.camera):
        if found is not None:
            joints = detection_joints(config)
            coloured = measure_colours(session, span, decode(Detections, found), joints, context.on_unit)
            return Output(found, interim=_colours(coloured))
        networks = networks_of(config)
        if config.uses_fields:
            fields = detect_fields_chunk(session, task.camera, span, load_detector(networks.body), context.on_unit)
            return Output(encode(fields))
        detector = open_detection(networks, detected_joints(config), _sizes(context, task.camera))
        detections = detect_chunk(session, task.camera, span, detector, context.on_unit, config.uses_colours)
        interim = _colours(detections) if config.uses_colours else None
        return Output(encode(replace(detections, colour=no_colours())), interim=interim)


def _colours(detections: Detections) -> bytes:
    """Colours of bodies, which are not kept with a session."""
    return encode_arrays({"colour": detections.colour})


def find_board(task: Task, context: Context) -> Output:
    """Look for the board in frames of a camera."""
    session, making = context.session(), context.config.making
    if isinstance(session, KeypointSession) or task.camera is None:
        raise PipelineError("A board is looked for in videos.")
    if not isinstance(making, CalibrationChoices) or making.board is None:
        raise PipelineError("The job looks for no board.")
    number = [camera.name for camera in session.cameras].index(task.camera)
    times_s = [times.time_s for times in session.times.values()]
    span = min(float(one[0]) for one in times_s), max(float(one[-1]) for one in times_s)
    own_s = session.times[task.camera].time_s
    frames = frames_to_look_at(own_s, span, 1.0 / session.timebase.frame_rate_hz)
    if making.has_photographs:
        frames, own_s = photographs_to_look_at(len(own_s)), np.full(len(own_s), np.nan)
    board = parse_board(making.board)
    with context.video(task.camera):
        views = look_in_video(session.videos[number], task.camera, own_s, frames, board, context.on_unit)
    return Output(encode(views))


def calibrate(task: Task, context: Context) -> Output:
    """Make a calibration from the views of a board, or from the people of a session."""
    making, on_share = context.config.making, _on_share(task, context)
    if not isinstance(making, CalibrationChoices):
        raise PipelineError("The job makes no calibration.")
    if making.board is None:
        session = context.session()
        joints = session.joints if isinstance(session, KeypointSession) else detection_joints(context.config)
        detections = (
            session.detections
            if isinstance(session, KeypointSession)
            else all_bodies(context, session, joints, detected_bodies(context))
        )
        made = calibrate_people(
            session.cameras,
            session.times,
            detections,
            joints,
            making.stature_m,
            making.has_intrinsics,
            on_share,
            making.known_points,
        )
        return _calibrated(made, context)
    outline = context.outline()
    given = {camera.name: camera for camera in outline.cameras} if making.has_intrinsics else None
    views = [decode(BoardViews, content) for content in context.outputs(FIND_BOARD)]
    board, rate_hz = parse_board(making.board), outline.timebase.frame_rate_hz
    made = calibrate_board(views, board, given, rate_hz, on_share=on_share, known_points=making.known_points)
    return _calibrated(made, context)


def _calibrated(made: CalibrationResult, context: Context) -> Output:
    """Write the calibration, its report and its pictures."""
    report, texts = report_document(made), encodings(made.cameras)
    written = {
        "calibration.json": texts["multicap"],
        "report.json": json.dumps(report, indent=1) + "\n",
        **made.pictures,
    }
    for name, text in written.items():
        (context.scratch / name).write_text(text, encoding="utf-8")
    files = tuple(_result_file(context.scratch / name) for name in written)
    warnings = tuple(Finding(one.code, str(one), one.camera, hint=one.hint) for one in listed(made.warnings))
    return Output(texts["multicap"].encode(), files, warnings, calibration={"files": texts, "report": report})


def synchronize_cameras(task: Task, context: Context) -> Output:
    """Measure when the frames of each camera were taken, from all people of the session."""
    if context.config.uses_fields and context.facts.has_videos:
        message = "Cameras are synchronised from whole bodies; this network finds joints."
        raise InputError([Problem("sync_needs_bodies", message, hint="Choose another detector, or declare offsets.")])
    session = context.session()
    joints = session.joints if isinstance(session, KeypointSession) else detection_joints(context.config)
    detections = (
        session.detections
        if isinstance(session, KeypointSession)
        else all_bodies(context, session, joints, detected_bodies(context))
    )
    sound = SoundOffsets() if isinstance(session, KeypointSession) else listen(session, context.video)
    return Output(encode(measure_clocks(session, detections, joints, sound, _on_share(task, context))))


def make_proxy(task: Task, context: Context) -> Output:
    """Make a small copy of a camera's video that browsers play."""
    session = context.session()
    if isinstance(session, KeypointSession) or task.camera is None:
        raise PipelineError("Proxies are made of videos.")
    number = [camera.name for camera in session.cameras].index(task.camera)
    path = context.scratch / proxy_name(number)
    with context.video(task.camera):
        make_proxy_in_child(session.videos[number], session.times[task.camera].time_s, path, context.on_unit)
    return Output(b"", (ResultFile(path.name, PROXY_KIND, None, "video/mp4", path),))


def check_people_of_session(task: Task, context: Context) -> Output:
    """Check the session by the people at a few instants, on measured clocks if they were measured."""
    session, clocks = context.session(), measured_clocks(context)
    joints = session.joints if isinstance(session, KeypointSession) else detection_joints(context.config)
    cut = FrameCut(task.frames, context.facts.stretches, task.chunk_frames)
    if clocks is None or isinstance(session, KeypointSession):
        session = session if clocks is None else on_measured_clocks(session, clocks)
        detected = partial(detected_in, task, context, session, joints)
        check = check_session(session, joints, cut, detected)
        has_bodies = isinstance(session, KeypointSession) or not context.config.uses_fields
        if clocks is None and has_bodies:
            check = with_clocks(check, session, joints, cut, detected)
        return Output(encode(check))
    detections = all_bodies(context, session, joints, detected_bodies(context))
    return Output(encode(check_bodies(on_measured_clocks(session, clocks), detections, joints, cut.parts)))


def refine_calibration(task: Task, context: Context) -> Output:
    """Refine the calibration from the people that a first association finds."""
    session, joints = on_clocks(context, context.session())
    on_share = _on_share(task, context)
    if context.config.uses_fields and not isinstance(session, KeypointSession):
        cut = FrameCut(task.frames, context.facts.stretches, task.chunk_frames)

        def chunks() -> Iterator[tuple[range, DetectionsByCamera]]:
            for number, frames in enumerate(cut):
                yield from_first(frames, task.frames.start), detected_in(task, context, session, joints, number, frames)

        refined = refine_from_fields(session, chunks, joints, context.config, on_share)
    else:
        detections = (
            session.detections
            if isinstance(session, KeypointSession)
            else all_bodies(context, session, joints, detected_bodies(context))
        )
        refined = refine_from_bodies(session, detections, joints, context.config, on_share)
    return Output(encode(refined))


def measure_lengths(task: Task, context: Context) -> Output:
    """Measure everybody's bones in frames all over the session, a range of frames at a time."""
    session, joints = wanted_inputs(context, context.session())
    cut = FrameCut(task.frames, context.facts.stretches, task.chunk_frames)
    damaged: list[DamagedFrames] = []
    changes: list[tuple[str, PictureChanges]] = []

    def ranges() -> Iterator[tuple[range, DetectionsByCamera]]:
        for number, frames in enumerate(cut):
            detected = detected_in(task, context, session, joints, number, frames)
            damaged.extend((camera, of_camera.damaged) for camera, of_camera in detected.items())
            changes.extend((camera, of_camera.changes) for camera, of_camera in detected.items())
            yield measured_frames(context, session, frames), detected

    lengths = measure_bones(session, ranges(), joints, context.config, context.on_unit)
    return Output(encode(MeasuredBones(lengths, damaged_videos(session, damaged, changes))))


def find_poses(task: Task, context: Context) -> Output:
    """Find people in a range of output frames, each instant by itself."""
    session, joints = wanted_inputs(context, context.session())
    detected = detected_in(task, context, session, joints, task.index, task.frames)
    lengths = decode(MeasuredBones, *context.outputs(LENGTHS)).lengths
    frames = measured_frames(context, session, task.frames)
    return Output(encode(locate_people(session, frames, detected, lengths, joints, context.config, context.on_unit)))


def associate_people(task: Task, context: Context) -> Output:
    """Turn bodies or poses of all frames into tracks: one pass in time order."""
    on_share = _on_share(task, context)
    if context.config.method == "clustering":
        session, joints = wanted_inputs(context, context.outline())
        poses = (decode(Poses3D, content) for content in context.outputs(POSES))
        people = link(session, poses, without_hands(joints), context.config, on_share)
        damaged = decode(MeasuredBones, *context.outputs(LENGTHS)).damaged
    else:
        bodies, damaged = gathered_bodies(context)
        session, joints = wanted_inputs(context, context.outline())
        bodies = without_fingers(bodies, joints)
        people = track(session, bodies, context.config, on_share)
        del bodies
    archive = context.scratch / PEOPLE
    write_people(archive, people, damaged)
    del people
    return Output(archive.read_bytes())


def identify_people(task: Task, context: Context) -> Output:
    """Find out who is who, from the tracks of the whole session, and attach people's hands."""
    session, joints = wanted_inputs(context, context.outline())
    archive = archive_of_people(context, ASSOCIATE)
    colour = gathered_bodies(context)[0].colour if context.config.uses_colours and context.facts.has_videos else None
    tracked = StoredPeople(archive)
    people = assign_identities(session, tracked.people, without_hands(joints), context.config, colour)
    del colour
    if has_hands(joints):
        people = attach(session, people, gathered_bodies(context)[0], joints, context.config)
    write_people(archive, people, tracked.damaged)
    del people
    _on_share(task, context)(1.0)
    return Output(archive.read_bytes())


def fit_skeletons(task: Task, context: Context) -> Output:
    """Animate one skeleton a person."""
    return Output(encode(_animation(task, context)))


def edit_people(task: Task, context: Context) -> Output:
    """Put the people whom the edits change together, from those who were found."""
    found = StoredPeople(archive_of_people(context, IDENTIFY))
    session, _ = wanted_inputs(context, context.outline())
    take = edited_take(found.spans, context.config, session.timebase)
    edited = context.scratch / EDITED
    write_people(edited, changed_people(found.people, found.spans, take))
    _on_share(task, context)(1.0)
    return Output(edited.read_bytes())


def refit_skeletons(task: Task, context: Context) -> Output:
    """Animate a part of the people whom edits changed; the others keep their animation."""
    return refit(task, context, _on_share(task, context))


def draw_overlay(task: Task, context: Context) -> Output:
    """Make a camera's video with the skeletons drawn over it."""
    if task.camera is None:
        raise PipelineError("Overlays are of one camera each.")
    with context.video(task.camera):
        file = overlay_file(context, assemble(context), task.camera)
    return _made([] if file is None else [file])


def write_report(task: Task, context: Context) -> Output:
    """Write the report of the take."""
    return _made([report_file(context, _on_share(task, context))])


def write_people_of_part(task: Task, context: Context) -> Output:
    """Write the files of a part of the people whom ``export`` finds again."""
    config, kept = context.config, FilesInPieces(Pieces(task, context), context.scratch)
    choices = config.exports, config.bvh, config.output_rate_hz
    rows = slice(task.index, None, PERSON_PARTS)
    keep_people(assemble(context), rows, context.scratch, *choices, _on_share(task, context), kept)
    return Output(b"", pieces=kept.pieces.made)


def export(task: Task, context: Context) -> Output:
    """Write the result files, and an index of them."""
    reconstruction = assemble(context)
    config = context.config
    on_share = _on_share(task, context)
    pieces = Pieces(task, context)
    kept = FilesInPieces(pieces, context.scratch) if context.keeps_pieces else NOTHING_KEPT
    choices = config.exports, config.bvh, config.output_rate_hz
    views, take = cache(views_of), TakeInPieces(pieces, context.scratch, config.edits)
    report: ReportOf = partial(take.report, views=views) if context.keeps_pieces else quality_report
    written = write_files(reconstruction, context.scratch, *choices, on_share, kept, report)
    names = {f"person-{motion.track_id}": motion.name for motion in reconstruction.motions}
    files = [_result_file(path, names) for path in written.paths]
    if context.has_viewers:
        frames = kept_frames(context)
        first_frame = 0 if frames is None else frames.start

        def made() -> Iterable[ResultFile]:
            of_take = views(reconstruction), context.outline(), written.metrics, context.scratch
            return viewer_files(reconstruction, *of_take, first_frame)

        files += take.viewer_files(reconstruction, made) if context.keeps_pieces else made()
    warnings = tuple(all_checks(written.metrics))
    output = _made(files, metrics=written.metrics)
    return replace(output, warnings=warnings, people=spans_found(context), pieces=pieces.made)


def _made(files: Sequence[ResultFile], **figures: Any) -> Output:
    """Result files, and an index of them with figures about them."""
    return Output(json.dumps({"files": [file.name for file in files], **figures}).encode(), tuple(files))


def _sizes(context: Context, camera: str) -> CameraSizes | None:
    """Sizes of a camera's images; ``None``: the usual size of the network."""
    if not networks_of(context.config).is_sized:
        return None
    index = list(context.facts.camera_rates_hz).index(camera)
    return decode(CameraSizes, *context.outputs(LOOK, slice(index, index + 1)))


def _on_share(task: Task, context: Context) -> OnShare:
    return in_units(task.num_units, context.on_unit)


def _animation(task: Task, context: Context) -> Animation:
    session, joints = wanted_inputs(context, context.outline())
    people = StoredPeople(archive_of_people(context, IDENTIFY)).people
    # Windows of all observations are asked for again and again, a track but once.
    in_memory = tuple(people.observations)
    on_share = _on_share(task, context)
    offsets = used_offsets(session, context.config)
    return animate(
        people.tracks, in_memory, session.cameras, session.timebase, joints, context.config, on_share, offsets
    )


def _result_file(path: Path, names: Mapping[str, str] = MappingProxyType({})) -> ResultFile:
    """Result file by its path; ``names`` are those of people, by their numbers in names of files."""
    is_of_person = path.suffix.removeprefix(".") in FILE_FORMATS
    kind = path.stem if path.suffix == ".json" else path.suffix.removeprefix(".")
    person = path.stem if is_of_person else None
    person_name = None if person is None else names[person]
    return ResultFile(path.name, kind, person, _MEDIA_TYPES[path.suffix], path, person_name)


_FUNCTIONS: Mapping[str, Callable[[Task, Context], Output]] = {
    function.__name__: function
    for function in (
        look,
        detect,
        find_board,
        calibrate,
        synchronize_cameras,
        make_proxy,
        check_people_of_session,
        refine_calibration,
        measure_lengths,
        find_poses,
        associate_people,
        identify_people,
        fit_skeletons,
        edit_people,
        refit_skeletons,
        draw_overlay,
        write_report,
        write_people_of_part,
        export,
    )
}
