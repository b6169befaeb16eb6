"""Joints of detections, and offsets of joint centres that a session is fitted with."""

import pytest

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession
from pipeline.config import JointCenters, ReconstructionConfig
from pipeline.data import Timebase
from pipeline.detect.entries import REGISTRY
from pipeline.joints import BODY_FEET, COCO_17, COCO_18, WHOLE_BODY, JointSet
from pipeline.stages.inputs import detection_joints, used_offsets

VIDEOS = CaptureSession((), (), {}, ())
KEYPOINTS = KeypointSession((), {}, Timebase(0.0, 25.0, 1), {}, COCO_17, {}, ())


@pytest.mark.parametrize(
    ("choice", "of_videos", "of_keypoints"),
    [
        ("auto", "blazepose-full", None),
        ("off", None, None),
        ("openpose-mobilenet-thin", "openpose-mobilenet-thin", "openpose-mobilenet-thin"),
    ],
)
def test_offsets_are_those_of_the_detector_or_those_that_are_chosen(
    choice: JointCenters, of_videos: str | None, of_keypoints: str | None
) -> None:
    config = ReconstructionConfig(joint_centers=choice)
    for session, name in ((VIDEOS, of_videos), (KEYPOINTS, of_keypoints)):
        assert used_offsets(session, config) == (REGISTRY[name].offsets if name else {})


def test_smoothing_other_than_the_fit_moves_nothing_and_a_network_without_offsets_has_none() -> None:
    assert REGISTRY["movenet-multipose"].offsets
    assert used_offsets(VIDEOS, ReconstructionConfig(smoothing="none")) == {}
    assert used_offsets(VIDEOS, ReconstructionConfig(detector="human-pose-estimation-0001")) == {}


def test_joints_that_crops_do_not_refine_have_the_offsets_of_the_detector_of_bodies() -> None:
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
def test_detections_have_the_joints_that_are_asked_for(config: ReconstructionConfig, joints: JointSet) -> None:
    assert detection_joints(config) is joints
