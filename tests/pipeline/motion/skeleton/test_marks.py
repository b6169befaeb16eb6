"""Marks beside joint centres: conversion in both directions, and the fit of people whose marks are offset."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17, LIMBS, MARKED_AT_CENTERS, JointOffset, JointOffsets
from pipeline.core.options.config import ReconstructionConfig, Smoothing
from pipeline.detection.entries import REGISTRY
from pipeline.export.quality.report import quality_report
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.landmarks import Landmarks, bone_lengths_m
from pipeline.motion.skeleton.marks import (
    centers_from_marks,
    mark_offsets_m,
    marks_from_centers,
    part_of_mark,
    trunk_length_m,
)
from pipeline.motion.skeleton.model import INDEX, SKELETON, joint_pose
from pipeline.validation.simulation.scenes import find_scene, record
from pipeline.validation.simulation.views.detector import PERFECT
from tests.pipeline.conftest import ring_camera

OFFSETS: JointOffsets = {
    "shoulder": JointOffset(outwards=-0.03, forward=0.02, up=0.08),
    "hip": JointOffset(forward=0.05),
    "ear": JointOffset(outwards=-0.04, forward=0.04),
    "nose": JointOffset(forward=-0.05),
}
CAMERAS = tuple(ring_camera(f"cam{k}", angle) for k, angle in enumerate((0.2, 1.8, 3.3, 4.9)))
SHOULDERS = COCO_17.indices(("left_shoulder", "right_shoulder"))


def standing() -> np.ndarray:
    """Joints (1, 17, 3) of a person who stands upright, faces -Y, and has a trunk of half a metre."""
    place = {
        "nose": (0.0, -0.11, 1.6), "left_eye": (0.032, -0.08, 1.63), "left_ear": (0.075, 0.0, 1.61),
        "left_shoulder": (0.17, 0.0, 1.4), "left_elbow": (0.2, 0.0, 1.1), "left_wrist": (0.2, 0.0, 0.85),
        "left_hip": (0.1, 0.0, 0.9), "left_knee": (0.1, 0.0, 0.5), "left_ankle": (0.1, 0.0, 0.08),
    }  # fmt: skip
    mirrored = {name.replace("left", "right"): (-x, y, z) for name, (x, y, z) in place.items()}
    return np.array([[(mirrored | place)[name] for name in COCO_17.names]])


def test_offsets_point_outwards_forward_and_up_from_body() -> None:
    found = mark_offsets_m(COCO_17, OFFSETS, 0.5)
    np.testing.assert_allclose(found["left_shoulder"], (-0.015, -0.01, 0.04))
    np.testing.assert_allclose(found["right_shoulder"], (0.015, -0.01, 0.04))
    np.testing.assert_allclose(found["nose"], (0.0, 0.025, 0.0))
    assert set(found) == {
        "nose",
        *(f"{side}_{kind}" for side in ("left", "right") for kind in ("shoulder", "hip", "ear")),
    }


def test_marks_of_standing_person_become_centres() -> None:
    true_m = standing()
    offsets_m = mark_offsets_m(COCO_17, {"shoulder": OFFSETS["shoulder"]}, 0.5)
    placed_m = true_m.copy()
    for name, offset_m in offsets_m.items():
        placed_m[:, COCO_17.index(name)] += offset_m * (1.0, 0.0, 1.0)
    landmarks = Landmarks(placed_m, np.full(placed_m.shape[:2], Source.MEASURED), COCO_17)
    upright = {"shoulder": replace(OFFSETS["shoulder"], forward=0.0)}
    found_m = centers_from_marks(landmarks, upright, bone_lengths_m(landmarks))
    np.testing.assert_allclose(found_m, true_m, atol=1e-9)


@cache
def truth() -> tuple[Track3D, Animation]:
    """A simulated person, and the skeleton that is closest to it: its joints are the true centres."""
    simulation = record(replace(find_scene("room"), duration_s=3.0, detector=PERFECT), seed=4)
    true_m, shape = simulation.truth_m[0], simulation.truth_m[0].shape[:2]
    source = np.full(shape, Source.MEASURED, np.int8)
    track = Track3D(1, 0, true_m, np.ones(shape), source, np.zeros(shape), np.full(shape, 4))
    config = ReconstructionConfig(feet="off")
    return track, animate([track], [observed(true_m)], CAMERAS, simulation.timebase, COCO_17, config)


def observed(xyz_m: np.ndarray) -> Observations:
    """Exact observations of positions by all cameras."""
    points_px = np.stack([project(camera, xyz_m) for camera in CAMERAS], axis=1)
    return Observations(1, points_px, np.full(points_px.shape[:3], 0.9))


def marks_m(offsets: JointOffsets) -> np.ndarray:
    """Marks beside the true centres."""
    (track,), (motion,) = truth()[1].tracks, truth()[1].motions
    return marks_from_centers(track.xyz_m, motion, slice(0, track.num_frames), COCO_17, offsets)


def fitted(offsets: JointOffsets, smoothing: Smoothing = "fit") -> Animation:
    """Animate the person from marks beside the centres by ``OFFSETS``, with given offsets."""
    places_m = marks_m(OFFSETS)
    track = replace(truth()[0], xyz_m=places_m)
    timebase = Timebase(0.0, 25.0, track.num_frames)
    config = ReconstructionConfig(feet="off", smoothing=smoothing)
    return animate([track], [observed(places_m)], CAMERAS, timebase, COCO_17, config, offsets=offsets)


def test_fit_moves_joints_from_marks_to_centres() -> None:
    true_m, animation = truth()[1].tracks[0].xyz_m, fitted(OFFSETS)

    def error_m(one: Animation) -> np.ndarray:
        return np.asarray(np.linalg.norm(one.tracks[0].xyz_m - true_m, axis=-1))

    assert error_m(fitted(MARKED_AT_CENTERS))[:, SHOULDERS].mean() > 0.03
    assert error_m(animation)[:, SHOULDERS].mean() < 0.004
    assert error_m(animation).mean() < 0.004
    # Joints are still those of the skeleton, and its bones those between centres.
    motion = animation.motions[0]
    for joint in SKELETON:
        if len(joint.landmarks) == 1:
            posed_m, _ = joint_pose(motion, joint.name)
            np.testing.assert_allclose(
                animation.tracks[0].xyz_m[:, COCO_17.index(joint.landmarks[0])], posed_m, atol=1e-6
            )
    for one, other in LIMBS:
        lengths_m = [
            np.linalg.norm(xyz_m[:, COCO_17.index(one)] - xyz_m[:, COCO_17.index(other)], axis=-1)
            for xyz_m in (true_m, animation.tracks[0].xyz_m)
        ]
        assert abs(np.median(lengths_m[0]) - np.median(lengths_m[1])) < 0.005


def test_errors_in_pixels_are_those_of_marks() -> None:
    animation = fitted(OFFSETS)
    (track,), seen = animation.tracks, observed(marks_m(OFFSETS))
    assert track.error_px[:, SHOULDERS].mean() < 1.0
    reconstruction = Reconstruction(
        CAMERAS, COCO_17, Timebase(0.0, 25.0, track.num_frames), [track], [seen], animation, offsets=OFFSETS
    )
    by_joint = quality_report(reconstruction)["reprojection_error_px"]["by_joint"]
    assert by_joint["left_shoulder"] < 1.0
    centers = quality_report(replace(reconstruction, offsets=MARKED_AT_CENTERS))["reprojection_error_px"]["by_joint"]
    assert centers["left_shoulder"] > 4.0


@pytest.mark.parametrize("smoothing", ["none", "butterworth"])
def test_only_fit_moves_joints(smoothing: Smoothing) -> None:
    ours, theirs = (fitted(offsets, smoothing) for offsets in (OFFSETS, MARKED_AT_CENTERS))
    np.testing.assert_array_equal(ours.tracks[0].xyz_m, theirs.tracks[0].xyz_m)


def test_somebody_without_trunk_is_fitted_without_offsets() -> None:
    xyz_m, elbow = np.full((20, 17, 3), np.nan), COCO_17.index("left_elbow")
    xyz_m[:, elbow] = (0.3, 0.2, 1.0)
    points_px = np.full((20, len(CAMERAS), 17, 2), np.nan)
    points_px[:, :, elbow] = np.stack([project(camera, xyz_m[:, elbow]) for camera in CAMERAS], axis=1)
    score = np.where(np.isfinite(points_px[..., 0]), 0.9, 0.0)
    source = np.where(np.isfinite(xyz_m[..., 0]), Source.MEASURED, Source.ABSENT).astype(np.int8)
    track = Track3D(1, 0, xyz_m, score.max(1), source, np.zeros(source.shape), (score > 0).sum(1))
    seen = Observations(1, points_px, score)
    arguments = [track], [seen], CAMERAS, Timebase(0.0, 25.0, 20), COCO_17, ReconstructionConfig()
    ours, theirs = animate(*arguments, offsets=OFFSETS), animate(*arguments)
    np.testing.assert_array_equal(ours.tracks[0].xyz_m, theirs.tracks[0].xyz_m)
    np.testing.assert_array_equal(ours.tracks[0].error_px, theirs.tracks[0].error_px)
    assert ours.tracks[0].uncertainty_m is None


def test_networks_have_offsets_of_their_own_joints() -> None:
    for entry in REGISTRY.values():
        kinds = {name.rpartition("_")[2] for name in entry.joints.names}
        assert set(entry.offsets) <= kinds
        for name in mark_offsets_m(entry.joints, entry.offsets, trunk_length_m(np.ones(len(SKELETON)))):
            assert part_of_mark(name) in INDEX
