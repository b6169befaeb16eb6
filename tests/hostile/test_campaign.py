"""Hostile media, calibrations, keypoints and timestamps in the real service, with jobs of accepted sessions.

A short campaign is part of the suite; ``make hostile`` sends 5,000 videos and archives of images, 500 calibrations and
500 sessions of keypoints. ``MULTICAP_HOSTILE_SEED`` is the seed, ``MULTICAP_HOSTILE_SHARE`` the share of these counts.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.e2e.serving import serving
from tests.hostile.calibrations import spoilt_calibrations
from tests.hostile.campaign import Campaign, CampaignReport, Part, alive
from tests.hostile.keypoints import keypoint_files, simulate, spoilt_keypoints
from tests.hostile.media import good_videos, spoilt_videos
from worker.store.model.rights import Scope
from worker.store.store import JobStore

SEED = int(os.environ.get("MULTICAP_HOSTILE_SEED", "18"))
SHARE = float(os.environ.get("MULTICAP_HOSTILE_SHARE", "1"))
SENDERS = 3
VIDEOS_A_SESSION = 8
METHODS = ("tracking", "clustering")
KINDS = {".zip": "keypoints", ".csv": "timestamps"}

T = TypeVar("T")


def chunks(items: Iterator[T], size: int) -> Iterator[list[T]]:
    while chunk := list(islice(items, size)):
        yield chunk


def rig(names: Sequence[str]) -> bytes:
    """Calibration of cameras on a circle that look at its centre."""
    return json.dumps(
        {
            "schema_version": 1,
            "cameras": [_camera(name, 2 * np.pi * index / len(names)) for index, name in enumerate(names)],
        }
    ).encode()


def _camera(name: str, angle_rad: float) -> dict[str, object]:
    rotation = Rotation.from_euler("x", 90, degrees=True) * Rotation.from_euler("z", angle_rad)
    return {
        "name": name,
        "size_px": [64, 48],
        "matrix": [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]],
        "distortion": [],
        "rotation": rotation.as_matrix().tolist(),
        "translation_m": [0.0, 1.0, 4.0],
    }


def video_session(videos: Mapping[str, bytes]) -> list[Part]:
    """Parts of a session of videos by their file names."""
    names = [Path(name).stem for name in videos]
    return [
        *(("videos", name, content) for name, content in videos.items()),
        ("calibration", "rig.json", rig(names)),
        # Archives of images have no frame rate.
        ("manifest", "", b'{"frame_rate_hz": 25}'),
    ]


def keypoint_session(files: Mapping[str, bytes]) -> list[Part]:
    """Parts of a session of keypoints."""
    return [(KINDS.get(Path(name).suffix, "calibration"), name, content) for name, content in files.items()]


def send_videos(campaign: Campaign, good: Mapping[str, bytes], videos: Sequence[tuple[str, bytes]]) -> None:
    """Send damaged videos as one session; then a job of an intact video and the videos without own problems."""
    named = {f"v{index}{Path(name).suffix}": content for index, (name, content) in enumerate(videos)}
    answer = campaign.send(video_session(named))
    if answer.status_code == 201:
        campaign.delete(answer.json()["id"])
    refused = {one["file"] for one in answer.json()["errors"]} if answer.status_code == 422 else set()
    accepted = {name: content for name, content in named.items() if name not in refused}
    if accepted:
        campaign.send(video_session({"good.mp4": good["a.mp4"], **accepted}), {"smoothing": "fit"})


def send_all(
    campaign: Campaign, folder: Path, num_videos: int, num_calibrations: int, num_keypoints: int
) -> CampaignReport:
    """Send numbers of damaged videos, calibrations and keypoint sessions with several senders at once."""
    simulation = simulate()
    keypoints = keypoint_files(simulation)
    videos = good_videos(folder)
    without_calibration = {name: content for name, content in keypoints.items() if name != "calibration.json"}

    def calls() -> Iterator[Callable[[], object]]:
        for batch in chunks(spoilt_videos(videos, SEED, num_videos), VIDEOS_A_SESSION):
            yield partial(send_videos, campaign, videos, batch)
        spoilt = islice(spoilt_calibrations(simulation.cameras, SEED, num_calibrations), num_calibrations)
        for index, (name, content) in enumerate(spoilt):
            parts = keypoint_session(without_calibration | {name: content})
            yield partial(campaign.send, parts, {"method": METHODS[index % 2]})
        for index, files in enumerate(islice(spoilt_keypoints(simulation, SEED, num_keypoints), num_keypoints)):
            yield partial(campaign.send, keypoint_session(files), {"method": METHODS[index % 2]})

    with campaign.observed() as report, ThreadPoolExecutor(SENDERS) as pool:
        for batch_of_calls in chunks(calls(), 4 * SENDERS):
            for sent in [pool.submit(call) for call in batch_of_calls]:
                sent.result()
    return report


@pytest.fixture
def campaign(tmp_path: Path) -> Iterator[Campaign]:
    """Run a campaign with two tenants on a new service."""
    data = tmp_path / "data"
    data.mkdir()
    store = JobStore(f"sqlite:///{data / 'multicap.db'}")
    store.migrate()
    keys = [store.keys.add(name, name, {Scope.READ, Scope.WRITE}, None)[1] for name in ("hostile", "ordinary")]
    store.close()
    with serving(data) as served:
        with closing(
            Campaign(served, keys[0], keys[1], keypoint_session(keypoint_files(simulate(num_views=3))))
        ) as one:
            yield one
        assert alive(served)


def run(campaign: Campaign, folder: Path, *counts: int) -> CampaignReport:
    folder.mkdir()
    report = send_all(campaign, folder, *counts)
    print("\n" + "\n".join([f"seed {SEED}", *report.lines()]))  # noqa: T201
    report.check()
    assert report.job_ends["succeeded"] > 0
    return report


@pytest.mark.parametrize("share", [1, pytest.param(5, marks=pytest.mark.hostile)])
def test_short_campaign(campaign: Campaign, tmp_path: Path, share: int) -> None:
    run(campaign, tmp_path / "videos", 8 * share, 2 * share, 2 * share)


@pytest.mark.hostile
def test_whole_campaign(campaign: Campaign, tmp_path: Path) -> None:
    run(campaign, tmp_path / "videos", *(round(SHARE * count) for count in (5000, 500, 500))).check_times()
