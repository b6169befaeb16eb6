"""A real browser for tests of the page: one for all tests of a group, and a context of its own for each test."""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, ViewportSize, expect, sync_playwright

from tests.e2e.foreign import READERS

AXE = READERS / "node_modules/axe-core/axe.min.js"
VENDOR = Path(__file__).parents[2] / "api" / "portal" / "vendor"
# The browser makes no requests of its own, root may start it, and it draws 3D in software.
FLAGS = [
    *("--no-sandbox", "--disable-background-networking", "--disable-component-update"),
    *("--disable-gpu", "--enable-unsafe-swiftshader"),
]
# Messages of Chromium about its own drawing in software.
OWN = ("GPU stall due to ReadPixels",)
DESKTOP: ViewportSize = {"width": 1280, "height": 800}
# Pages take longer on a busy machine; a test that fails waits so long.
expect.set_options(timeout=30_000)

_running = contextlib.ExitStack()
_shared: Browser | None = None


@contextlib.contextmanager
def opened(url: str, viewport: ViewportSize = DESKTOP, *, allowed: tuple[str, ...] = ()) -> Iterator[Page]:
    """Open the page without anything stored; at the end of the block check that its console has no errors.

    Parameters
    ----------
    allowed
        Parts of errors that the test provokes, such as the status of a refused request.
    """
    page = _browser().new_page(base_url=url, viewport=viewport)
    try:
        with _checked(page, allowed):
            page.goto(url)
            yield page
    finally:
        page.context.close()


def close_browser() -> None:
    """Close the browser, if a test has started it. While it runs, no other event loop can run in this thread."""
    _running.close()


def chromium_path() -> str:
    """Path of Chromium; a test without it is skipped."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("there is no chromium (`make browser` installs it on Debian)")
    return chromium


def _browser() -> Browser:
    """Browser of the group's tests, started by the first of them."""
    global _shared  # noqa: PLW0603 - it lives from one test to the next
    chromium = chromium_path()
    if not VENDOR.is_dir():
        pytest.skip("the page's libraries are not installed (`make setup`)")
    if _shared is None or not _shared.is_connected():
        _running.close()
        playwright = _running.enter_context(sync_playwright())
        _shared = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        _running.callback(_shared.close)
    return _shared


@contextlib.contextmanager
def opened_by_a_stranger(
    page: Page, url: str, viewport: ViewportSize = DESKTOP, *, allowed: tuple[str, ...] = ()
) -> Iterator[Page]:
    """Open an address in the browser of a page as ``opened`` does, without the cookies and the storage of the page."""
    browser = page.context.browser
    assert browser is not None
    other = browser.new_page(viewport=viewport)
    with _checked(other, allowed):
        other.goto(url)
        yield other
    other.context.close()


@contextlib.contextmanager
def _checked(page: Page, allowed: tuple[str, ...]) -> Iterator[None]:
    """Check at the end of the block that the console of a page has no errors."""
    complaints: list[str] = []

    def complain(message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"} and not any(part in message.text for part in (*OWN, *allowed)):
            complaints.append(f"{message.type}: {message.text}")

    page.on("console", complain)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    yield
    assert complaints == [], complaints


def choose_option(field: Locator, text: str) -> None:
    """Choose the first option of a field that begins with a text."""
    expect(field.locator("option").filter(has_text=text).first).to_be_attached(timeout=180_000)
    labels = field.locator("option").all_inner_texts()
    field.select_option(label=next(label for label in labels if label.startswith(text)))


def axe_findings(page: Page, within: str = "html") -> list[str]:
    """Violations that axe-core finds in the page, or a part of it, as it is; the test is skipped without axe-core."""
    if not AXE.is_file():
        pytest.skip("axe-core is not installed (`make readers`)")
    page.evaluate(AXE.read_text())
    found = page.evaluate("(within) => axe.run(within, { resultTypes: ['violations'] })", within)["violations"]
    return [f"{one['id']}: {node['html'][:200]}" for one in found for node in one["nodes"]]
