"""Damaged sessions over HTTP with the real preflight: 201 or 4xx with clear problems, never 5xx."""

import itertools
import json
import random
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from api.web.settings import Settings
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.api.conftest import NO_BROKER, Live, running
from tests.hostile.calibrations import spoilt_calibrations
from tests.hostile.keypoints import keypoint_files, simulate, spoilt_keypoints
from tests.hostile.media import good_videos, spoilt_videos
from tests.hostile.programs import spoilt_programs
from tests.hostile.test_hostile_files import SEED, is_clear

MAX_S = 30.0
CAMERA = {
    "size_px": [64, 48],
    "matrix": [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]],
    "distortion": [],
    "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "translation_m": [0.0, 0.0, 3.0],
}


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    folder = tmp_path_factory.mktemp("service")
    with running(Settings(data_dir=folder / "data", broker_url=NO_BROKER)) as found:
        yield found


def post(live: Live, files: list[tuple[str, tuple[str, bytes]]], address: str = "/v1/sessions") -> httpx2.Response:
    """Send a session; check that the response comes in time, with a session or with its problems."""
    started_s = time.monotonic()
    answer = live.client.post(address, files=files)
    assert time.monotonic() - started_s < MAX_S
    assert answer.status_code in {201, 413, 422}, answer.text
    if answer.status_code == 422:
        errors: list[dict[str, Any]] = answer.json()["errors"]
        assert is_clear([{name: text for name, text in one.items() if name != "pointer"} for one in errors]), errors
    return answer


def parts_of(files: dict[str, bytes]) -> list[tuple[str, tuple[str, bytes]]]:
    """Parts of a form of keypoints."""
    kinds = {".zip": "keypoints", ".csv": "timestamps"}
    return [(kinds.get(Path(name).suffix, "calibration"), (name, content)) for name, content in files.items()]


def test_calibrations_keypoints_and_timestamps(live: Live) -> None:
    simulation = simulate()
    good = keypoint_files(simulation)
    assert post(live, parts_of(good)).status_code == 201
    spoilt: list[dict[str, bytes]] = list(spoilt_keypoints(simulation, SEED, 50))
    for name, content in spoilt_calibrations(simulation.cameras, SEED, 50):
        spoilt.append({other: one for other, one in good.items() if other != "calibration.json"} | {name: content})
    for files in random.Random(SEED).sample(spoilt, 5):  # noqa: S311 - the same each time
        post(live, parts_of(files))


@pytest.mark.hostile
def test_300_calibrations(live: Live) -> None:
    """Calibrations in all formats, damaged, with good keypoints: each is taken or refused within the limit of time."""
    simulation = simulate()
    good = {name: content for name, content in keypoint_files(simulation).items() if name != "calibration.json"}
    spoilt = itertools.islice(spoilt_calibrations(simulation.cameras, SEED, 300), 300)
    codes = Counter(post(live, parts_of(good | {name: content})).status_code for name, content in spoilt)
    assert codes.total() == 300
    assert codes[422] > 150


def send_alone(live: Live, spoilt: Iterable[tuple[str, bytes]]) -> Counter[int]:
    """Send calibrations as resources of their own; those that are taken stay readable."""
    codes: Counter[int] = Counter()
    for name, content in spoilt:
        answer = post(live, [("calibration", (name, content))], "/v1/calibrations")
        codes[answer.status_code] += 1
        if answer.status_code == 201:
            urls = answer.json()["urls"]
            assert live.client.get(urls["self"]).status_code == 200
            for file_format in ("multicap", "anipose", "caliscope", "opencv"):
                # A format may be unable to hold a calibration: 404.
                download = live.client.get(urls["file"], params={"format": file_format})
                assert download.status_code in {200, 404}
    return codes


def test_files_of_other_programs(live: Live) -> None:
    """Each bomb, and a few files with random damage."""
    codes = send_alone(live, spoilt_programs(simulate().cameras, SEED, 12))
    assert codes.total() == 12
    assert codes[422] >= 8


@pytest.mark.hostile
def test_300_files_of_other_programs(live: Live) -> None:
    codes = send_alone(live, spoilt_programs(simulate().cameras, SEED + 2, 300))
    assert codes.total() == 300
    assert codes[422] > 150


@pytest.mark.hostile
def test_300_calibrations_of_their_own(live: Live) -> None:
    codes = send_alone(live, itertools.islice(spoilt_calibrations(simulate().cameras, SEED + 1, 300), 300))
    assert codes.total() == 300
    assert codes[422] > 150


def test_videos(live: Live, tmp_path: Path) -> None:
    good = good_videos(tmp_path)
    for name, content in itertools.islice(spoilt_videos(good, SEED, 6), 6):
        ending = Path(name).suffix
        post(live, videos(f"left{ending}", content, f"right{ending}", good[name]))


def test_every_video_taken_has_keyframe(tmp_path: Path) -> None:
    (tmp_path / "good").mkdir()
    refused = 0
    for name, content in spoilt_videos(good_videos(tmp_path / "good"), 3, 200):
        (tmp_path / name).write_bytes(content)
        found = probe(tmp_path / name)
        if isinstance(found, VideoInfo):
            assert len(found.keyframe_pts) > 0
        else:
            refused += found.code == "no_keyframes"
    assert refused > 0


def videos(name: str, content: bytes, other_name: str, other: bytes) -> list[tuple[str, tuple[str, bytes]]]:
    """Parts of a form of two videos."""
    cameras = [CAMERA | {"name": "left"}, CAMERA | {"name": "right"}]
    calibration = json.dumps({"schema_version": 1, "cameras": cameras}).encode()
    return [("videos", (name, content)), ("videos", (other_name, other)), ("calibration", ("c.json", calibration))]
