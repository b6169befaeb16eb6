"""Detect leaning and close bodies again, which detectors miss or mix: expect them, then read them in crops.

The output of *Checking difficult poses* is an ``ExpectedBodies`` a camera, and the output of *Detecting difficult poses
again* a ``Detections`` for a range of a camera's frames.
"""

from functools import partial

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine import stage


def redetects_bodies(facts: stage.SessionFacts, config: ReconstructionConfig) -> bool:
    """Return whether difficult bodies are detected again: by networks of the profiles, which mark joints alike."""
    return facts.has_videos and config.is_of_people and config.networks.again is not None


@stage.declared(
    stage.EXPECT,
    "Checking difficult poses",
    cut="whole",
    follows=(stage.LOOK, stage.SYNCHRONIZE, stage.REFINE, stage.ASSOCIATE),
    choices=("people",),
    is_planned=redetects_bodies,
)
def expect_bodies(task: stage.Task, context: stage.Context) -> stage.Output:
    """Find the frames of each camera in which people are expected who lean or are close, and their places there."""
    from pipeline.association.redetection.expect import expect_bodies as expected_bodies
    from pipeline.core.runtime.record_archive import encode
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.methods import association_in
    from pipeline.run.engine.stored_people import found_people
    from pipeline.run.engine.wanted_frames import wanted_frames

    association = association_in(context, wanted_frames(context, context.outline()))
    # Places of people do not depend on the colours of their clothes, by which `identify` tells them apart, too.
    people = association.assign_identities(found_people(context, stage.ASSOCIATE).people)
    return stage.Output(
        encode(
            expected_bodies(
                list(zip(people.tracks, people.observations, strict=True)),
                association.cameras,
                association.times,
                association.timebase,
                association.joints,
                detection_source(context).turns_deg,
            )
        )
    )


@stage.declared(
    stage.REDETECT,
    "Detecting difficult poses again",
    cut="camera ranges",
    follows=(stage.LOOK, stage.SYNCHRONIZE, stage.EXPECT),
    choices=("profile", "joints", "detector", "output"),
    is_planned=redetects_bodies,
    frames_a_unit=10,
    reads_videos=True,
    runs_networks=True,
)
def redetect(task: stage.Task, context: stage.Context) -> stage.Output:
    """Read the joints of expected bodies in crops; nothing is loaded or decoded where no person is expected."""
    from pipeline.association.redetection.crops import detect_expected
    from pipeline.association.redetection.expect import ExpectedBodies
    from pipeline.core.joints import without_hands
    from pipeline.core.runtime.record_archive import decode, encode
    from pipeline.detection.profiles.profile_detector import load_landmarks
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.wanted_frames import captured_videos
    from pipeline.video.timeline import frames_in, span_s

    session, camera, networks = captured_videos(context), task.one_camera, context.config.networks
    if networks.again is None:
        raise ValueError("These networks look for no person again: the stage is not planned.")
    detections = detection_source(context)
    (expected,) = context.outputs(stage.EXPECT)
    number = list(context.facts.camera_rates_hz).index(camera)
    span = span_s(session.timebase, task.frames.start, task.frames.stop)
    bodies = decode(tuple[ExpectedBodies, ...], expected)[number].within(frames_in(session.times[camera], *span))
    on_share = context.on_share(task)
    with context.video(camera):
        found = detect_expected(
            session,
            bodies,
            partial(load_landmarks, networks.again),
            without_hands(detections.joints(session)),
            networks.refines_body,
            detections.turns_deg[camera],
            on_share,
        )
    on_share(1.0)
    return stage.Output(encode(found))
