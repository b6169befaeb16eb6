"""Keypoint files of simulations: bodies, feet and hands in OpenPose's layout."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.joints import BODY_25, finger_joints
from pipeline.validation.simulation.scenes import SCENES, Joints, Simulation, record, simulation_files
from pipeline.validation.simulation.views.detector import PERFECT


def person_of(joints: Joints) -> tuple[Simulation, dict[str, np.ndarray]]:
    """A simulation, and the entries of the first person in the first frame of its first camera."""
    simulation = record(replace(SCENES["hands"], duration_s=0.5, detector=PERFECT), 1, 2, joints)
    files = dict(simulation_files(simulation))
    people = json.loads(files["keypoints/cam_00/frame_000000000000_keypoints.json"])["people"]
    assert len(people) == 2
    return simulation, {name: np.reshape(values, (-1, 3)) for name, values in people[0].items()}


def test_bodies_have_joints_of_coco() -> None:
    simulation, person = person_of("body")
    assert list(person) == ["pose_keypoints_2d"]
    np.testing.assert_allclose(person["pose_keypoints_2d"][:, :2], simulation.detections["cam_00"].keypoints_px[0])


@pytest.mark.parametrize("joints", ["feet", "whole"])
def test_feet_are_those_of_body_25(joints: Joints) -> None:
    simulation, person = person_of(joints)
    found = simulation.detections["cam_00"]
    body = dict(zip(BODY_25.names, person["pose_keypoints_2d"], strict=True))
    for name in ("nose", "left_wrist", "right_ankle", "left_heel", "right_big_toe"):
        column = simulation.joints.index(name)
        np.testing.assert_allclose(body[name], [*found.keypoints_px[0, column], found.score[0, column]])
    shoulders = found.keypoints_px[0, simulation.joints.indices(("left_shoulder", "right_shoulder"))]
    np.testing.assert_allclose(body["neck"][:2], shoulders.mean(0))
    np.testing.assert_array_equal(body["left_small_toe"], 0.0)


def test_hands_begin_at_wrist() -> None:
    simulation, person = person_of("whole")
    found_px = simulation.detections["cam_00"].keypoints_px[0]
    assert list(person) == ["pose_keypoints_2d", "hand_left_keypoints_2d", "hand_right_keypoints_2d"]
    for side in ("left", "right"):
        columns = simulation.joints.indices((f"{side}_wrist", *finger_joints(side)))
        np.testing.assert_allclose(person[f"hand_{side}_keypoints_2d"][:, :2], found_px[columns])
    assert list(person_of("feet")[1]) == ["pose_keypoints_2d"]


def test_neck_needs_both_shoulders() -> None:
    simulation = record(replace(SCENES["hands"], duration_s=0.2), 1, 2, "feet")
    found = simulation.detections["cam_00"]
    without = replace(found, score=np.where(np.arange(21) == 5, 0.0, found.score))
    files = dict(simulation_files(replace(simulation, detections={**simulation.detections, "cam_00": without})))
    people = json.loads(files["keypoints/cam_00/frame_000000000000_keypoints.json"])["people"]
    neck = np.reshape(people[0]["pose_keypoints_2d"], (-1, 3))[BODY_25.index("neck")]
    np.testing.assert_array_equal(neck, 0.0)
