"""Keypoint files of a frame in OpenPose's form."""

import json

import numpy as np
import pytest

from pipeline.capture.keypoint_files.writing import encode_frame
from pipeline.core.joints import BODY_25, COCO_17, WHOLE_BODY, JointSet


@pytest.mark.parametrize("joints", [COCO_17, BODY_25, WHOLE_BODY], ids=["body", "feet", "whole"])
def test_frame_without_bodies_has_no_people(joints: JointSet) -> None:
    num_joints = len(joints.names)
    content = encode_frame(np.empty((0, num_joints, 2)), np.empty((0, num_joints)), joints)
    assert json.loads(content)["people"] == []
