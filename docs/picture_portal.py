"""Pictures of the page: ``docs/images/portal-*``, with the installed sample capture.

``.venv/bin/python docs/picture_portal.py URL``: the address of a service that needs no key, such as ``make serve`` with
an empty data folder. Chromium takes the pictures. The moving picture holds a part of the take on the page *Take*.
"""

import argparse
import io
import re
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

from pipeline.core.runtime.packages import samples

IMAGES = Path(__file__).parent / "images"
SIZE_PX = {"width": 1280, "height": 800}
VIEWER_PX = {"x": 20, "y": 275, "width": 1240, "height": 365}
NAME = "Two people on a stage"
JOB_MS = 900_000
# The moving picture: frames of the take that are shown, how often, and its width.
FIRST, LAST, STEP = 20, 90, 3
SHOWN_MS, WIDTH_PX, QUALITY = 110, 720, 50


def picture(page: Page, name: str) -> None:
    """Store what the page shows."""
    page.screenshot(path=IMAGES / f"portal-{name}.jpg", type="jpeg", quality=70)


def send(page: Page) -> None:
    """Choose the files of the sample, and send them for Blender."""
    sample = samples.locate()
    if sample is None:
        raise SystemExit("Run first: multicap samples install")
    page.locator("#choose-files").set_input_files([*sample.videos.values(), sample.calibration])
    page.get_by_label("Name of the capture").fill(NAME)
    page.get_by_role("radio", name="Blender").check()
    button = page.get_by_role("button", name="Send and reconstruct")
    expect(button).to_be_enabled(timeout=JOB_MS)
    expect(page.get_by_text("Checking the calibration")).to_have_count(0, timeout=JOB_MS)
    page.evaluate("scrollTo(0, 0)")
    picture(page, "send")
    button.click()
    expect(page).to_have_url(re.compile("#/jobs/"), timeout=JOB_MS)
    expect(page.get_by_text("Done").first).to_be_visible(timeout=JOB_MS)


def look(page: Page) -> None:
    """Open the take, and store it in one picture and in motion."""
    page.get_by_role("navigation").get_by_role("link", name="Captures").click()
    page.get_by_role("link", name=f"Open {NAME}").first.wait_for(timeout=JOB_MS)
    picture(page, "captures")
    page.get_by_role("link", name=f"Open {NAME}").first.click()
    page.locator("canvas").first.wait_for(timeout=JOB_MS)
    page.wait_for_timeout(5000)
    play_head = page.get_by_role("slider").first
    play_head.focus()
    page.keyboard.press("Home")
    pictures = []
    for number in range(LAST):
        if number >= FIRST and (number - FIRST) % STEP == 0:
            # Videos show the frame a moment later than the bodies.
            page.wait_for_timeout(600)
            shown = Image.open(io.BytesIO(page.screenshot(clip=VIEWER_PX))).convert("RGB")
            height_px = round(WIDTH_PX * shown.height / shown.width)
            pictures.append(shown.resize((WIDTH_PX, height_px), Image.Resampling.LANCZOS))
        if number == (FIRST + LAST) // 2:
            picture(page, "look")
        page.keyboard.press("ArrowRight")
    # There and back, so that it has no jump.
    moving = [*pictures, *pictures[-2:0:-1]]
    moving[0].save(
        IMAGES / "portal-look.webp", save_all=True, append_images=moving[1:], duration=SHOWN_MS, loop=0, quality=QUALITY
    )


def main() -> None:
    """Take all pictures."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("url", help="address of a running service")
    url = words.parse_args().url
    with sync_playwright() as playwright:
        path = shutil.which("chromium") or shutil.which("google-chrome")
        flags = ["--disable-gpu", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=path, args=flags)
        page = browser.new_page(viewport=SIZE_PX)
        page.goto(url)
        send(page)
        look(page)
        browser.close()


if __name__ == "__main__":
    main()
