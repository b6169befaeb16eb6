"""A real browser for tests of the page."""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import ConsoleMessage, Page, ViewportSize, sync_playwright

VENDOR = Path(__file__).parents[2] / "api" / "portal" / "vendor"
# The browser makes no requests of its own, root may start it, and it draws 3D in software.
FLAGS = [
    *("--no-sandbox", "--disable-background-networking", "--disable-component-update"),
    *("--disable-gpu", "--enable-unsafe-swiftshader"),
]
# What Chromium tells about its own drawing in software.
OWN = ("GPU stall due to ReadPixels",)
DESKTOP: ViewportSize = {"width": 1280, "height": 800}


@contextlib.contextmanager
def opened(url: str, viewport: ViewportSize = DESKTOP, *, allowed: tuple[str, ...] = ()) -> Iterator[Page]:
    """Open the page in a new browser; at the end of the block check that its console has no errors.

    Parameters
    ----------
    allowed
        Parts of errors that the test provokes, such as the status of a refused request.
    """
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("there is no chromium (`make browser` installs it on Debian)")
    if not VENDOR.is_dir():
        pytest.skip("the page's libraries are not installed (`make setup`)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(base_url=url, viewport=viewport)
        complaints: list[str] = []

        def complain(message: ConsoleMessage) -> None:
            if message.type in {"error", "warning"} and not any(part in message.text for part in (*OWN, *allowed)):
                complaints.append(f"{message.type}: {message.text}")

        page.on("console", complain)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(url)
        yield page
        browser.close()
    assert complaints == [], complaints
