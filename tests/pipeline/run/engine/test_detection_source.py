"""Questions of a task: joints of detections, offsets of joint centres, and the session that it was planned for."""

from pathlib import Path

import pytest

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession, Session
from pipeline.core.data.cameras import Timebase
from pipeline.core.errors import PipelineError
from pipeline.core.joints import BODY_FEET, COCO_17, COCO_18, WHOLE_BODY, JointOffsets, JointSet
from pipeline.core.options.config import JointCenters, ReconstructionConfig
from pipeline.detection.entries import REGISTRY
from pipeline.run.engine.detection_source import detection_source, joint_offsets
from pipeline.run.engine.local_tasks import LocalJob
from pipeline.run.engine.output_folder import OutputFolder
from pipeline.run.engine.stage import Context, SessionFacts
from pipeline.run.engine.wanted_frames import captured_videos

VIDEOS = CaptureSession((), (), {}, ())
KEYPOINTS = KeypointSession((), {}, Timebase(0.0, 25.0, 1), {}, COCO_17, {}, ())
NOWHERE = Path("nowhere")


def context_of(session: Session, config: ReconstructionConfig = ReconstructionConfig()) -> Context:  # noqa: B008
    facts = SessionFacts((), 1, 25.0, (range(1),), {}, has_videos=session is VIDEOS)
    folder = OutputFolder(NOWHERE)
    return LocalJob(session, config, facts, (), folder, folder, NOWHERE).context()


def used_offsets(session: Session, config: ReconstructionConfig) -> JointOffsets:
    return joint_offsets(context_of(session, config))


@pytest.mark.parametrize(
    ("choice", "of_videos", "of_keypoints"),
    [
        ("auto", "blazepose-full", None),
        ("off", None, None),
        ("openpose-mobilenet-thin", "openpose-mobilenet-thin", "openpose-mobilenet-thin"),
    ],
)
def test_offsets_are_detector_s_or_chosen(
    choice: JointCenters, of_videos: str | None, of_keypoints: str | None
) -> None:
    config = ReconstructionConfig(joint_centers=choice)
    for session, name in ((VIDEOS, of_videos), (KEYPOINTS, of_keypoints)):
        assert used_offsets(session, config) == (REGISTRY[name].offsets if name else {})


def test_offsets_without_fit_or_of_bare_networks_are_empty() -> None:
    assert REGISTRY["movenet-multipose"].offsets
    assert used_offsets(VIDEOS, ReconstructionConfig(smoothing="none")) == {}
    assert used_offsets(VIDEOS, ReconstructionConfig(detector="human-pose-estimation-0001")) == {}


def test_offsets_without_crops_are_body_detector_s() -> None:
    alone = ReconstructionConfig(detector="movenet-multipose")
    assert used_offsets(VIDEOS, alone) == REGISTRY["movenet-multipose"].offsets
    accurate = ReconstructionConfig(profile="accurate")
    assert used_offsets(VIDEOS, accurate) == REGISTRY["blazepose-heavy"].offsets
    assert used_offsets(VIDEOS, accurate)["shoulder"].up < used_offsets(VIDEOS, alone)["shoulder"].up


@pytest.mark.parametrize(
    ("config", "joints"),
    [
        (ReconstructionConfig(), BODY_FEET),
        (ReconstructionConfig(joints="body"), COCO_17),
        (ReconstructionConfig(joints="whole"), WHOLE_BODY),
        (ReconstructionConfig(detector="openpose-mobilenet-thin"), COCO_18),
    ],
)
def test_detections_have_joints_that_are_asked_for(config: ReconstructionConfig, joints: JointSet) -> None:
    assert detection_source(context_of(VIDEOS, config)).joints(VIDEOS) is joints
    assert detection_source(context_of(KEYPOINTS, config)).joints(KEYPOINTS) is COCO_17


def test_detections_of_keypoints_come_with_session() -> None:
    config = ReconstructionConfig("clustering", "openpose-mobilenet-thin")
    videos, keypoints = detection_source(context_of(VIDEOS, config)), detection_source(context_of(KEYPOINTS, config))
    assert (videos.finds_fields, keypoints.finds_fields) == (True, False)
    assert (videos.networks, keypoints.networks) == (("openpose-mobilenet-thin",), ())
    measured = [detection_source(context_of(session)).measures_colours for session in (VIDEOS, KEYPOINTS)]
    assert measured == [True, False]
    assert keypoints.bodies(KEYPOINTS) is KEYPOINTS.detections


def test_task_on_another_kind_of_session_than_planned_fails() -> None:
    with pytest.raises(PipelineError, match="planned for a CaptureSession, not for a KeypointSession"):
        captured_videos(context_of(KEYPOINTS))
    with pytest.raises(PipelineError, match="planned for a KeypointSession"):
        detection_source(context_of(KEYPOINTS)).bodies(VIDEOS)
