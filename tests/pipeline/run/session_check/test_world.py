"""Poses of people by whom the world is judged."""

import numpy as np

from pipeline.run.session_check.world import select_movers
from tests.pipeline.association.identity.test_likenesses import moving, poster

INSTANTS = np.arange(10, 240, 20)


def test_pictures_judge_no_world_while_somebody_moves() -> None:
    rng = np.random.default_rng(0)
    # Three pairs of cameras locate the picture each time, and the person who comes late; once they locate nothing.
    instants = [*sorted(3 * list(range(12))), *sorted(3 * list(range(4, 12))), 11]
    nothing_m = np.full((1, 17, 3), np.nan)
    poses_m = np.concatenate(
        [np.repeat(poster(1)[INSTANTS], 3, axis=0), np.repeat(moving(2)[INSTANTS[4:]], 3, axis=0), nothing_m]
    )
    poses_m += rng.normal(0.0, 0.01, poses_m.shape)
    np.testing.assert_array_equal(select_movers(instants, poses_m), poses_m[36:60])


def test_people_at_one_place_judge_world_alone() -> None:
    poses_m = poster(1)[INSTANTS]
    np.testing.assert_array_equal(select_movers(range(12), poses_m), poses_m)
    assert len(select_movers([], np.zeros((0, 17, 3)))) == 0
