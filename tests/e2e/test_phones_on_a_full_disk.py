"""Phones that record while the disk of the service fills up: clips wait on the phones until there is room."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.e2e.browsing import opened
from tests.e2e.datasets import folder_of, needs
from tests.e2e.phone_takes import PATIENT_MS, join, open_recording, phone_card, recording_of, start, take_card
from tests.e2e.phones import phones, write_camera
from tests.e2e.serving import Served, serving
from tests.small_disk import fill, small_disk

pytestmark = [needs("rendered"), pytest.mark.slow, pytest.mark.real_time]

FULL = "The service's disk is full."


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    with small_disk(tmp_path / "disk", 256) as disk, serving(disk / "data", 1) as served:
        yield served


@pytest.fixture
def cameras(tmp_path: Path) -> Iterator[list[tuple[str, Path]]]:
    """Names and files of the cameras of two phones."""
    found = []
    for number in range(2):
        target = tmp_path / f"camera_{number}.y4m"
        write_camera(folder_of("rendered") / "videos" / f"cam_{number}.mp4", target, 12, every=2)
        found.append((f"Phone {number + 1}", target))
    yield found
    for _, target in found:
        target.unlink()


def test_clips_wait_for_room(served: Served, cameras: list[tuple[str, Path]], tmp_path: Path) -> None:
    filler = served.data_dir / "filler"
    with opened(f"{served.client.base_url}#/record") as host:
        link = open_recording(host, "Full disk")
        with phones(host, link, cameras, tmp_path) as joined:
            join(host, joined)
            start(host, "Full", 2)
            fill(filler)
            host.get_by_role("button", name="Stop").click()
            for phone in joined:
                waiting = phone.page.get_by_role("list", name="On this phone")
                expect(waiting).to_contain_text(f"waits: {FULL}", timeout=PATIENT_MS)
                expect(phone_card(host, phone.name)).to_contain_text(FULL, timeout=PATIENT_MS)
            host.get_by_label("Name of the next take").fill("Another")
            host.get_by_role("button", name="Record", exact=True).click()
            expect(host.get_by_role("alert")).to_contain_text(FULL)
            expect(host.get_by_label("Name of the next take")).to_have_value("Another")
            filler.unlink()
            host.get_by_role("button", name="Record", exact=True).click()
            expect(host.locator(".record-time")).to_contain_text("Another", timeout=PATIENT_MS)
            expect(host.get_by_label("Name of the next take")).to_have_value("")
            host.get_by_role("button", name="Stop").click()
            expect(take_card(host, "Full")).to_contain_text("2 of 2 clips here", timeout=PATIENT_MS)
        take = recording_of(served, host)["takes"][0]
    for clip in take["clips"]:
        (file,) = clip["files"]
        assert (file["part"], file["facts"]["lost"]) == (1, [])
