"""Detect 2D joints: bodies in a range of a camera's frames, or the peaks and fields that clustering takes.

The output is a ``Detections`` without colours, or a ``PafFields``; the interim output is the colours of the bodies.
"""

from dataclasses import replace

from pipeline.run.engine.stage import DETECT, LOOK, Context, Output, Stage, Task
from pipeline.run.steps.look import is_detecting


def detect(task: Task, context: Context) -> Output:
    """Find bodies or fields. If nothing but the colours is missing, they are measured without the network."""
    from pipeline.core.data.arrays import no_colours
    from pipeline.core.data.detections import Detections
    from pipeline.core.runtime.npz import encode_arrays
    from pipeline.detection.chunk import detect_chunk, detect_fields_chunk, measure_colours
    from pipeline.detection.look import CameraLook
    from pipeline.detection.profiles.detection import load_detector, open_detection, turned
    from pipeline.run.engine.codec import decode, encode
    from pipeline.video.timeline import span_s

    session, config, camera, stored = context.videos(), context.config, task.one_camera, context.stored_output()
    span = span_s(session.timebase, task.frames.start, task.frames.stop)
    networks = config.networks
    number = list(context.facts.camera_rates_hz).index(camera)
    (look,) = context.records(LOOK, CameraLook, slice(number, number + 1))
    with context.video(camera):
        if stored is not None:
            joints = context.detections.joints(session)
            detections = measure_colours(session, span, decode(Detections, stored), joints, context.on_unit)
        elif config.uses_fields:
            finder = turned(load_detector(networks.body), look.turn_deg)
            return Output(encode(detect_fields_chunk(session, camera, span, finder, context.on_unit)))
        else:
            detector = open_detection(networks, config.detected_joints, look.sizes, look.turn_deg)
            detections = detect_chunk(
                session, camera, span, detector, context.on_unit, config.uses_colours, config.follow_s
            )
    content = stored or encode(replace(detections, colour=no_colours()))
    return Output(content, interim=encode_arrays({"colour": detections.colour}) if config.uses_colours else None)


STAGE = Stage(
    DETECT,
    "Detect 2D joints",
    detect,
    cut="camera ranges",
    follows=(LOOK,),
    choices=("profile", "joints", "detector", "follow_s", "output"),
    is_planned=is_detecting,
    unit="frames",
    reads_videos=True,
    runs_networks=True,
    leaves_interim=lambda config: config.uses_colours,
)
