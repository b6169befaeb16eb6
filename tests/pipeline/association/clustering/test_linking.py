import numpy as np
import pytest

from pipeline.association.clustering import linking
from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.linking import link, mean_distance_m

PARAMETERS = ClusteringParameters(tau1_px=8.0)


def torso(x_m: float, y_m: float = 0.0) -> np.ndarray:
    return np.tile([x_m, y_m, 1.2], (6, 1))


def test_people_who_pass_keep_their_tracks() -> None:
    instants_s = np.arange(20) / 20.0
    poses = []
    for k in range(20):
        pair = [torso(-1.0 + 0.1 * k), torso(1.0 - 0.1 * k, 0.4)]
        poses.append(np.array(pair[:: 1 if k % 2 else -1]))
    tracks = link(poses, instants_s, PARAMETERS)
    assert len(tracks) == 2
    for track in tracks:
        y_m = [poses[instant][number][0, 1] for instant, number in track.members]
        assert len(set(y_m)) == 1
        assert len(y_m) == 20


def test_track_without_poses_waits_and_then_ends() -> None:
    instants_s = np.arange(40) / 20.0
    none = np.empty((0, 6, 3))
    away = {*range(5, 9), *range(15, 30)}
    poses = [none if k in away else np.array([torso(0.01 * k)]) for k in range(40)]
    tracks = link(poses, instants_s, PARAMETERS)
    assert [track.members[0][0] for track in tracks] == [0, 30]
    assert len(tracks[0].members) == 11


def test_person_too_far_away_is_new() -> None:
    tracks = link([np.array([torso(0.0)]), np.array([torso(2.0)])], np.array([0.0, 0.04]), PARAMETERS)
    assert len(tracks) == 2


def test_track_with_missing_joints_continues() -> None:
    poses = []
    for k in range(6):
        pose = torso(0.02 * k)
        pose[k] = np.nan
        poses.append(pose[None])
    assert len(link(poses, np.arange(6) / 25.0, PARAMETERS)) == 1


def test_ended_tracks_cost_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    num_compared = []

    def counted(last_m: np.ndarray, torso_m: np.ndarray) -> np.ndarray:
        num_compared.append(last_m.shape[0])
        return mean_distance_m(last_m, torso_m)

    monkeypatch.setattr(linking, "mean_distance_m", counted)
    strangers = [np.array([torso(100.0 * instant)]) for instant in range(300)]
    shares: list[float] = []
    tracks = link(strangers, np.arange(300) / 25, PARAMETERS, shares.append)
    assert len(tracks) == 300
    assert max(num_compared) <= 25 * PARAMETERS.max_unseen_s + 1
    assert shares == [(instant + 1) / 300 for instant in range(300)]
