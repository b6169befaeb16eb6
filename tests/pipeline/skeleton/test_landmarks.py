"""Lengths of bones from landmarks: sides are pooled where they agree."""

import numpy as np
import pytest

from pipeline.data.people import Source
from pipeline.joints import COCO_17
from pipeline.skeleton.fitting.positions import limb_lengths
from pipeline.skeleton.landmarks import Landmarks, bone_lengths_m, lengths_of_sides_m
from pipeline.skeleton.model import INDEX
from tests.pipeline.skeleton.synthetic_tracks import SHIN_M, THIGH_M, track_of, walker

KNEE, ANKLE = COCO_17.indices(("left_knee", "left_ankle"))


def with_wrong_ankle(num_frames: int = 40) -> np.ndarray:
    """Walker whose left ankle is found 36 cm too far down the shin in most frames, and whose right one often is not."""
    xyz_m = walker(num_frames)
    shin = xyz_m[:, ANKLE] - xyz_m[:, KNEE]
    xyz_m[:, ANKLE] += 0.36 * shin / np.linalg.norm(shin, axis=-1, keepdims=True)
    xyz_m[::3, COCO_17.index("right_ankle")] = np.nan
    return xyz_m


def test_a_wrong_side_does_not_change_the_other_one() -> None:
    track = track_of(with_wrong_ankle())
    lengths_m = bone_lengths_m(Landmarks(track.xyz_m, track.source, COCO_17))
    assert lengths_m[INDEX["RightFoot"]] == pytest.approx(SHIN_M, abs=1e-6)
    assert lengths_m[INDEX["LeftFoot"]] == pytest.approx(SHIN_M + 0.36, abs=1e-6)
    assert lengths_m[INDEX["LeftLeg"]] == lengths_m[INDEX["RightLeg"]] == pytest.approx(THIGH_M)
    of_joints = limb_lengths(track, track.source == Source.MEASURED, COCO_17)
    assert dict(of_joints[COCO_17.index("right_ankle")])[COCO_17.index("right_knee")] == pytest.approx(SHIN_M)


def test_sides_that_agree_are_pooled() -> None:
    rng = np.random.default_rng(0)
    left_m, right_m = 0.40 + rng.normal(0.0, 0.02, 300), 0.42 + rng.normal(0.0, 0.02, 100)
    both = float(np.median(np.concatenate([left_m, right_m])))
    assert lengths_of_sides_m(left_m, right_m) == (both, both)


def test_few_lengths_that_scatter_are_pooled() -> None:
    left_m, right_m = np.array([0.30, 0.42, 0.55]), np.array([0.38, 0.50, 0.61])
    both = float(np.median(np.concatenate([left_m, right_m])))
    assert lengths_of_sides_m(left_m, right_m) == (both, both)


def test_a_side_that_was_never_measured_has_the_length_of_the_other_one() -> None:
    assert lengths_of_sides_m(np.array([np.nan]), np.array([0.4, 0.41, 0.42])) == (0.41, 0.41)
    assert np.isnan(lengths_of_sides_m(np.array([]), np.array([np.nan]))).all()
