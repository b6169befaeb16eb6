"""Process of a live capture with cameras: nothing of it is left behind."""

import asyncio
import time
from pathlib import Path

import pytest

from api.web.live.process import camera_process


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="reads /proc")
def test_children_of_process_end_with_it(tmp_path: Path) -> None:
    async def started() -> int:
        async with camera_process(["sh", "-c", "sleep 600 & echo $!; wait"], tmp_path, []) as process:
            return int(await process.reader.readline())

    child = asyncio.run(started())
    end_s = time.monotonic() + 10.0
    while is_running(child) and time.monotonic() < end_s:
        time.sleep(0.01)
    assert not is_running(child)
