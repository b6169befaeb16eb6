"""Pictures of a recording by phones: ``docs/images/phones-*``, with the installed sample capture in place of cameras.

``.venv/bin/python docs/picture_phones.py URL``: the address of a service that needs no key, such as ``make serve`` with
an empty data folder. A browser stands for each phone.
"""

import argparse
import contextlib
import re
import shutil
import tempfile
from pathlib import Path

import av
from playwright.sync_api import Page, ViewportSize, expect, sync_playwright

from pipeline.core.runtime.packages import samples

IMAGES = Path(__file__).parent / "images"
DESKTOP: ViewportSize = {"width": 1280, "height": 1000}
PORTRAIT: ViewportSize = {"width": 390, "height": 844}
LANDSCAPE: ViewportSize = {"width": 844, "height": 390}
NAMES = ("Window", "Door", "Shelf", "Table")
SIZE_PX, RATE_HZ = (544, 960), 30
FLAGS = ("--disable-gpu", "--enable-unsafe-swiftshader", "--no-sandbox")
CAMERA = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")
WAIT_MS = 120_000


def picture(page: Page, name: str) -> None:
    """Store what the page shows."""
    page.screenshot(path=IMAGES / f"phones-{name}.jpg", type="jpeg", quality=70)


def write_camera(video: Path, target: Path) -> None:
    """Write a video as a file that Chromium takes for a camera."""
    width, height = SIZE_PX
    with av.open(video) as source, target.open("wb") as file:
        file.write(f"YUV4MPEG2 W{width} H{height} F{RATE_HZ}:1 Ip A1:1 C420jpeg\n".encode())
        for frame in source.decode(video=0):
            file.write(b"FRAME\n" + frame.reformat(width, height, "yuv420p").to_ndarray().tobytes())


def take_pictures(host: Page, phones: list[Page]) -> None:
    """Record a take, and store what host and phone show of it."""
    phones[0].set_viewport_size(PORTRAIT)
    for phone, name in zip(phones, NAMES, strict=True):
        phone.get_by_label("Name of this phone").fill(name)
        phone.get_by_role("button", name="Allow the camera").click()
    expect(host.get_by_text(f"{len(phones)} phones ready")).to_be_visible(timeout=WAIT_MS)
    host.get_by_label("Name of the next take").fill("Handshake")
    host.locator("[name=video]").select_option("own")
    host.get_by_role("button", name="Record", exact=True).click()
    expect(host.locator(".record-time")).to_have_text(re.compile("Handshake · 0:0[5-9]"), timeout=WAIT_MS)
    picture(host, "host")
    picture(phones[0], "phone")
    phones[1].set_viewport_size(LANDSCAPE)
    phones[1].wait_for_timeout(700)
    picture(phones[1], "phone-landscape")
    host.get_by_role("button", name="Stop").click()


def main() -> None:
    """Take all pictures."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("url", help="address of a running service")
    url = words.parse_args().url
    sample = samples.locate()
    if sample is None:
        raise SystemExit("Run first: multicap samples install")
    path = shutil.which("chromium") or shutil.which("google-chrome")
    with (
        tempfile.TemporaryDirectory() as folder,
        sync_playwright() as playwright,
        contextlib.ExitStack() as held,
    ):
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        held.callback(browser.close)
        host = browser.new_page(viewport=DESKTOP)
        host.goto(f"{url}/#/record")
        host.get_by_label("Name of the recording").fill("Living room")
        host.get_by_role("button", name="New recording").click()
        link = host.locator(".record-link").get_attribute("href")
        assert link is not None  # noqa: S101 - for the type checker
        phones = []
        for name, video in zip(NAMES, sample.videos.values(), strict=True):
            camera = Path(folder) / f"{name}.y4m"
            write_camera(video, camera)
            args = [*FLAGS, *CAMERA, f"--use-file-for-fake-video-capture={camera}"]
            own = playwright.chromium.launch(executable_path=path, args=args)
            held.callback(own.close)
            phones.append(own.new_page())
            phones[-1].goto(link)
        take_pictures(host, phones)


if __name__ == "__main__":
    main()
