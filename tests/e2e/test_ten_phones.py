"""Ten phones for ten minutes: memory of their tabs and of the API, and frames that are lost."""

import os
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import av
import psutil
import pytest

from tests.e2e.browsing import opened
from tests.e2e.datasets import folder_of, needs
from tests.e2e.phone_takes import PATIENT_MS, join, open_recording, recording_of, start, take_card, uploaded_clips
from tests.e2e.phones import phones, write_camera
from tests.e2e.serving import Served

pytestmark = [pytest.mark.benchmark, needs("rendered")]

NUM_PHONES = 10
SIZE_PX, RATE_HZ = (320, 180), 15  # ten encoders of videos share the processors of one machine here
MINUTES = float(os.environ.get("MULTICAP_PHONES_MINUTES", "10"))
MIB = 2**20
MAX_GROWTH_MIB = 50.0  # of a tab, and of the API


@pytest.fixture
def camera(tmp_path: Path) -> Iterator[Path]:
    target = tmp_path / "camera.y4m"
    write_camera(folder_of("rendered") / "videos" / "cam_0.mp4", target, RATE_HZ, size_px=SIZE_PX)
    yield target
    target.unlink()


def tab_mib(user_data: Path) -> float:
    """Memory of the page of a browser alone, of the process that shows it."""
    flag = f"--user-data-dir={user_data}"
    browsers = [
        process
        for process in psutil.Process().children(recursive=True)
        if flag in (words := process.cmdline()) and not any(word.startswith("--type=") for word in words)
    ]
    pages = [process for process in browsers[0].children(recursive=True) if "--type=renderer" in process.cmdline()]
    return float(max(page.memory_full_info().uss for page in pages)) / MIB


def num_frames(video: Path) -> int:
    with av.open(video) as source:
        return sum(packet.size > 0 for packet in source.demux(source.streams.video[0]))


def test_ten_phones_record_for_minutes(served: Served, camera: Path, tmp_path: Path) -> None:
    names = [f"phone {number}" for number in range(1, NUM_PHONES + 1)]

    def memory_mib() -> tuple[float, float]:
        tabs = statistics.median(tab_mib(tmp_path / name) for name in names)
        return tabs, served.part("api").memory_full_info().uss / MIB

    with opened(f"{served.client.base_url}#/record") as host:
        link = open_recording(host, "Ten phones")
        with phones(host, link, [(name, camera) for name in names], tmp_path) as joined:
            join(host, joined)
            start(host, "Long", 1)
            began_s = time.monotonic()
            time.sleep(60.0)
            first = memory_mib()
            time.sleep(max(0.0, began_s + 60.0 * MINUTES - time.monotonic()))
            last = memory_mib()
            host.get_by_role("button", name="Stop").click()
            take_card(host, "Long").get_by_text(f"{NUM_PHONES} of {NUM_PHONES} clips here").wait_for(
                timeout=2 * PATIENT_MS
            )
        (take,) = recording_of(served, host)["takes"]
    clips = [clip["files"][0] for clip in take["clips"]]
    seconds = [clip["duration_s"] for clip in clips]
    dropped_frames = [clip["facts"]["dropped_frames"] for clip in clips]
    found = {
        "minutes": MINUTES,
        "tab_mib": [round(value, 1) for value in (first[0], last[0])],
        "api_mib": [round(value, 1) for value in (first[1], last[1])],
        "dropped_frames": dropped_frames,
        "frames_a_second": [
            round(num_frames(path) / duration, 2)
            for path, duration in zip(uploaded_clips(served, take), seconds, strict=True)
        ],
    }
    print(found)  # noqa: T201 - a benchmark's result
    assert last[0] - first[0] < MAX_GROWTH_MIB
    assert last[1] - first[1] < MAX_GROWTH_MIB
    assert not any(clip["facts"]["lost"] for clip in clips)
    assert not any(dropped_frames)
