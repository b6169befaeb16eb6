"""Detect people in videos: first how each camera hangs, then the joints of everybody in all frames.

*Scanning the videos* tells how a camera hangs and the size of its images, by the people in a few of its frames. Its
output is a ``CameraLook``, which belongs to the whole video, whatever part of it is wanted. *Finding people* finds
bodies in a range of a camera's frames, or the peaks and fields that clustering takes. Its output is a ``Detections``
without colours, or a ``PafFields``; its interim output is the colours of the bodies.
"""

from dataclasses import replace
from functools import partial

from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.job_choices import CalibrationChoices
from pipeline.run.engine.stage import DETECT, LOOK, Context, Output, SessionFacts, Task, declared

LOOKED_AT_FRAMES = 12
"""Largest number of frames of a camera that are looked at."""
# Fewer are enough for networks that are not sized, of which a pass takes longer.
_UNSIZED_FRAMES = 3


def _detects_people(facts: SessionFacts, config: ReconstructionConfig) -> bool:
    """True if a job has people detected in videos: to reconstruct them, or to calibrate by them."""
    making = config.making
    is_wanted = config.is_of_people or (isinstance(making, CalibrationChoices) and making.board is None)
    return facts.has_videos and is_wanted


@declared(
    LOOK,
    "Scanning the videos",
    cut="cameras",
    follows=(),
    choices=("profile", "detector", "poses"),
    is_planned=_detects_people,
    unit="frames",
    reads_videos=True,
    runs_networks=True,
    max_frames=LOOKED_AT_FRAMES,
)
def look(task: Task, context: Context) -> Output:
    """Look at the people in some frames of a camera's whole video: turn and size of its images."""
    from pipeline.core.runtime.record_archive import encode
    from pipeline.detection.look import look_at_people
    from pipeline.detection.profiles.profile_detector import open_finder, shows_lean
    from pipeline.detection.profiles.sizes import RULES
    from pipeline.detection.upright import turn_of_roll
    from pipeline.run.engine.wanted_frames import captured_videos

    session, config, name = captured_videos(context), context.config, task.one_camera
    networks = config.networks
    rule = RULES[config.profile] if networks.is_sized else None
    camera = next(camera for camera in session.cameras if camera.name == name)
    # A camera that is to be calibrated has no pose.
    known_deg = turn_of_roll(camera) if config.is_of_people else None
    with context.video(name):
        camera_look = look_at_people(
            session,
            name,
            open_turned=partial(open_finder, networks),
            rule=rule,
            known_deg=known_deg,
            max_frames=LOOKED_AT_FRAMES if networks.is_sized else _UNSIZED_FRAMES,
            shows_lean=shows_lean(networks),
            on_frame=context.on_unit,
        )
    return Output(encode(camera_look))


@declared(
    DETECT,
    "Finding people",
    cut="camera ranges",
    follows=(LOOK,),
    choices=("profile", "joints", "detector", "follow_s", "output"),
    is_planned=_detects_people,
    unit="frames",
    reads_videos=True,
    runs_networks=True,
    leaves_interim=lambda config: config.uses_colours,
)
def detect(task: Task, context: Context) -> Output:
    """Find bodies or fields. If nothing but the colours is missing, they are measured without the network."""
    from pipeline.core.data.arrays import no_colours
    from pipeline.core.data.detections import Detections
    from pipeline.core.runtime.npz import encode_arrays
    from pipeline.core.runtime.record_archive import decode, encode
    from pipeline.detection.chunk import detect_chunk, detect_fields_chunk, measure_colours
    from pipeline.detection.entries import detection_joints
    from pipeline.detection.profiles.profile_detector import load_detector, open_detection, turned
    from pipeline.detection.profiles.sizes import CameraLook
    from pipeline.run.engine.wanted_frames import captured_videos
    from pipeline.video.timeline import span_s

    session, config, camera, stored = captured_videos(context), context.config, task.one_camera, context.stored_output()
    span = span_s(session.timebase, task.frames.start, task.frames.stop)
    networks = config.networks
    number = list(context.facts.camera_rates_hz).index(camera)
    (camera_look,) = context.records(LOOK, CameraLook, slice(number, number + 1))
    with context.video(camera):
        if stored is not None:
            joints = detection_joints(config)
            detections = measure_colours(session, span, decode(Detections, stored), joints, context.on_unit)
        elif config.uses_fields:
            finder = turned(load_detector(networks.body), camera_look.turn_deg)
            return Output(encode(detect_fields_chunk(session, camera, span, finder, context.on_unit)))
        else:
            detector = open_detection(networks, config.detected_joints, camera_look.sizes, camera_look.turn_deg)
            detections = detect_chunk(
                session, camera, span, detector, context.on_unit, config.uses_colours, config.follow_s
            )
    content = stored or encode(replace(detections, colour=no_colours()))
    colours = encode_arrays({"colour": detections.colour}) if config.uses_colours else None
    return Output(content, interim=colours, first_people=_first_people(task, context, content))


def _first_people(task: Task, context: Context, content: bytes) -> bytes | None:
    """People of the task's frames, by the camera that is the last one to be done; clocks have to be known."""
    from pipeline.core.data.detections import Detections
    from pipeline.core.runtime.record_archive import decode
    from pipeline.detection.entries import detection_joints
    from pipeline.run.engine.first_people import first_people

    config, names = context.config, list(context.facts.camera_rates_hz)
    place = names.index(task.one_camera)
    first = task.index - place
    contents = context.finished(DETECT, slice(first, first + len(names)))
    if not contents or not config.is_of_people or config.sync == "auto":
        return None
    contents[place] = content
    detections = {
        name: decode(Detections, found) for name, found in zip(names, contents, strict=True) if found is not None
    }
    if len(detections) < len(names):
        return None
    session, joints = context.session(), detection_joints(config)
    return first_people(session.cameras, session.times, session.timebase, detections, joints, task.frames)
