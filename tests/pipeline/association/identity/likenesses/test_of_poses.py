"""Poses of instants, without pictures and mirror images."""

from collections.abc import Sequence

import numpy as np

from pipeline.association.identity.likenesses.of_poses import without_likenesses
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Poses3D
from pipeline.core.joints import COCO_17
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from tests.pipeline.association.identity.likenesses.scenes import RATE_HZ, Motion, mirrored, moving, poster

CAMERAS = build_cameras(Rig(Layout.RING, 3, (4.0, 4.0), 2.2), np.random.default_rng(0))
TIMEBASE, STEP = Timebase(0.0, RATE_HZ, 240), 3


def poses(people_m: Sequence[Motion], seen: Sequence[Sequence[int]]) -> Poses3D:
    """Poses of people at every third frame, instant by instant, in a changing order."""
    rng = np.random.default_rng(1)
    rows = [(frame, int(person)) for frame in range(0, 240, STEP) for person in rng.permutation(len(people_m))]
    xyz_m = np.array([people_m[person][frame] for frame, person in rows])
    points_px = np.full((len(rows), 17, 3, 2), np.nan)
    for row, (_, person) in enumerate(rows):
        points_px[row][:, list(seen[person])] = person
    xyz_m += rng.normal(0.0, 0.01, xyz_m.shape)
    return Poses3D(np.array([frame for frame, _ in rows]), xyz_m, points_px, np.isfinite(points_px[..., 0]) * 0.9)


def kept(of_instants: Sequence[Poses3D]) -> np.ndarray:
    """Numbers of the people whose poses are left, which are their points."""
    left = without_likenesses(of_instants, CAMERAS, COCO_17, TIMEBASE, STEP)
    assert all(len(some.frame) == len(some.xyz_m) == len(some.score) for some in left)
    return np.concatenate([np.nanmax(some.points_px.reshape(len(some.frame), -1), axis=1) for some in left])


def test_those_who_move_are_left() -> None:
    normal = -CAMERAS[0].cam_from_world.rotation[2] * [1.0, 1.0, 0.0]
    normal /= np.linalg.norm(normal)
    image_m = mirrored(moving(2), normal, 1.8)  # a wall before the first camera
    all_poses = poses([moving(2), poster(1), image_m], [(0, 1, 2), (0, 1, 2), (1, 2)])
    assert kept([all_poses]).tolist() == [0.0] * 80
    halves = [
        Poses3D(all_poses.frame[rows], all_poses.xyz_m[rows], all_poses.points_px[rows], all_poses.score[rows])
        for rows in (slice(0, 117), slice(117, None))
    ]
    assert kept(halves).tolist() == [0.0] * 80


def test_all_stay_if_nobody_moves() -> None:
    assert len(kept([poses([poster(1), poster(2) + np.array([0.0, 1.5, 0.0])], [(0, 1), (1, 2)])])) == 160
    assert without_likenesses([], CAMERAS, COCO_17, TIMEBASE, STEP) == []
