"""Ten phones for ten minutes: memory of their tabs and of the API, and frames that are lost.

One machine plays all phones here, so encoders may lose frames by its load alone. Every second phone draws no
thumbnails: what the others lose beyond these phones is lost by thumbnails.
"""

import os
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import av
import psutil
import pytest
from playwright.sync_api import ViewportSize

from tests.e2e.browsing import opened
from tests.e2e.datasets import folder_of, needs
from tests.e2e.phone_takes import PATIENT_MS, join, open_recording, recording_of, start, take_card, uploaded_clips
from tests.e2e.phones import phones, write_camera
from tests.e2e.serving import Served

pytestmark = [pytest.mark.benchmark, needs("rendered")]

NUM_PHONES = 10
# Ten browsers draw and encode videos on the processors of one machine here.
SIZE_PX, RATE_HZ = (160, 90), 5
VIEWPORT: ViewportSize = {"width": 320, "height": 480}
MINUTES = float(os.environ.get("MULTICAP_PHONES_MINUTES", "10"))
MIB = 2**20
MAX_GROWTH_MIB = 50.0  # of a tab, and of the API
MAX_LOST_BY_THUMBNAILS = 0.005  # share of the frames
NO_THUMBNAILS = """() => {
  CanvasRenderingContext2D.prototype.drawImage = () => {};
  HTMLCanvasElement.prototype.toBlob = () => {};
}"""


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
        with phones(host, link, [(name, camera) for name in names], tmp_path, VIEWPORT) as joined:
            join(host, joined)
            for phone in joined[1::2]:
                phone.page.evaluate(NO_THUMBNAILS)
            start(host, "Long", 1)
            began_s = time.monotonic()
            time.sleep(60.0)
            first = memory_mib()
            time.sleep(max(0.0, began_s + 60.0 * MINUTES - time.monotonic()))
            last = memory_mib()
            print({"tab_mib": (first[0], last[0]), "api_mib": (first[1], last[1])}, flush=True)  # noqa: T201
            host.get_by_role("button", name="Stop").click(timeout=PATIENT_MS)
            take_card(host, "Long").get_by_text(f"{NUM_PHONES} of {NUM_PHONES} clips here").wait_for(
                timeout=2 * PATIENT_MS
            )
        recording = recording_of(served, host)
    (take,) = recording["takes"]
    name_of = {phone["number"]: phone["name"] for phone in recording["phones"]}
    clips = {name_of[clip["phone"]]: clip["files"][0] for clip in take["clips"]}
    assert sorted(clips) == sorted(names)
    lost = [
        [clips[name]["facts"]["dropped_frames"] / (RATE_HZ * clips[name]["duration_s"]) for name in of_group]
        for of_group in (names[0::2], names[1::2])
    ]
    with_thumbnails, without = (statistics.fmean(shares) for shares in lost)
    found = {
        "minutes": MINUTES,
        "share_of_dropped_frames": {"with thumbnails": with_thumbnails, "without": without, "phones": lost},
        "frames_a_second": [
            round(num_frames(path) / clip["files"][0]["duration_s"], 2)
            for path, clip in zip(uploaded_clips(served, take), take["clips"], strict=True)
        ],
    }
    print(found)  # noqa: T201 - a benchmark's result
    assert last[0] - first[0] < MAX_GROWTH_MIB
    assert last[1] - first[1] < MAX_GROWTH_MIB
    assert not any(clip["facts"]["lost"] for clip in clips.values())
    assert with_thumbnails - without < MAX_LOST_BY_THUMBNAILS
