"""Sound of a session's videos: offsets on the declared clock, and cameras whose sound has other times."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pipeline.capture.preflight_record import Recording
from pipeline.capture.session import open_session
from pipeline.capture.synchronization.session_clocks import listen
from pipeline.validation.simulation.scenes import find_scene, record, simulation_files
from tests.pipeline.media import write_video
from tests.pipeline.video.test_sound import CLICKS_S, clicks, filmed


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Videos of three cameras with sound, one 0.2 s late, of one without sound, and their calibration."""
    folder = tmp_path_factory.mktemp("session")
    (folder / "videos").mkdir()
    document = json.loads(dict(simulation_files(record(find_scene("room"), 1, 4)))["calibration.json"])
    for number, camera in enumerate(document["cameras"]):
        camera["size_px"] = [64, 48]
        path = folder / "videos" / f"{camera['name']}.mp4"
        if number == 3:
            write_video(path, 100)
        else:
            late_s = 0.2 if number == 1 else 0.0
            filmed(path, clicks(4.0, tuple(one - late_s for one in CLICKS_S), seed=number))
    (folder / "calibration.json").write_text(json.dumps(document))
    return folder


@pytest.mark.slow
def test_offsets_of_videos_with_sound_and_reasons_of_others(folder: Path) -> None:
    session = open_session(folder / "videos", folder / "calibration.json")
    first, second, third, silent = (camera.name for camera in session.cameras)
    read: list[str] = []

    @contextmanager
    def reading(camera: str) -> Iterator[None]:
        read.append(camera)
        yield

    found = listen(session, reading)
    assert read == [first, second, third, silent]
    assert dict(found.offset_s) == pytest.approx({first: 0.0, second: 0.2, third: 0.0}, abs=0.003)
    assert dict(found.reasons) == {silent: "The video has no sound."}


def test_sound_of_video_whose_rate_was_stated_is_not_used(folder: Path) -> None:
    whole = open_session(folder / "videos", folder / "calibration.json")
    second = whole.cameras[1].name
    session = open_session(folder / "videos", folder / "calibration.json", [Recording(second, frame_rate_hz=24.0)])
    found = listen(session, lambda camera: nothing())
    assert second not in found.offset_s
    assert "rate was stated" in found.reasons[second]


@contextmanager
def nothing() -> Iterator[None]:
    yield
