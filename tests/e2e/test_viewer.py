"""Viewer in a real browser: drawing, keyboard, layouts, ranges, pairs, problems."""

import pytest
from playwright.sync_api import expect

from pipeline.motion.body.makehuman import NUM_COARSE_TRIANGLES
from tests.api.conftest import Live
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.viewer_pages import Shown, job_ids, live, numbered_video, shown

__all__ = ["job_ids", "live", "numbered_video", "shown"]


def test_people_are_drawn_and_named(shown: Shown) -> None:
    shown.mount()
    for number in (1, 2, 3):
        expect(shown.page.locator(".look-label-person", has_text=f"person-{number}")).to_be_visible()
    # Bodies: pixels in the person's own colour around the middle of the picture.
    colours = shown.page.evaluate(
        """() => {
          const { stage } = globalThis.viewer.view;
          stage.renderer.render(stage.scene, stage.camera);
          const { width, height } = stage.canvas;
          const sheet = Object.assign(document.createElement("canvas"), { width, height });
          const context = sheet.getContext("2d");
          context.drawImage(stage.canvas, 0, 0);
          const { data } = context.getImageData(0, 0, width, height);
          let bright = 0;
          for (let place = 0; place < data.length; place += 4) {
            const [red, green, blue] = data.slice(place, place + 3);
            if (Math.max(red, green, blue) - Math.min(red, green, blue) > 90) bright += 1;
          }
          return bright / (data.length / 4);
        }"""
    )
    assert 0.005 < colours < 0.5
    assert shown.page.evaluate("() => globalThis.viewer.view.stage.renderer.info.render.calls") <= 10


TRIANGLES = """() => {
  const { stage, people: { humans, capsules } } = globalThis.viewer.view;
  stage.renderer.render(stage.scene, stage.camera);
  const { triangles } = stage.renderer.info.render;
  return { triangles, humans: humans.mesh.visible, capsules: capsules.visible };
}"""


@pytest.mark.slow
def test_bodies_are_humans_or_capsules(shown: Shown) -> None:
    shown.mount()
    humans = shown.page.evaluate(TRIANGLES)
    assert (humans["humans"], humans["capsules"]) == (True, False)
    shown.page.get_by_text("Show", exact=True).click()
    shown.page.get_by_label("Foot contacts").uncheck()
    shown.page.get_by_label("Bodies as").select_option("capsule")
    capsules = shown.page.evaluate(TRIANGLES)
    assert (capsules["humans"], capsules["capsules"]) == (False, True)
    shown.page.get_by_label("Bodies as").select_option("human")
    discs = shown.page.evaluate(TRIANGLES)["triangles"] - 3 * NUM_COARSE_TRIANGLES
    assert discs == humans["triangles"] - 3 * NUM_COARSE_TRIANGLES >= 0
    shown.page.get_by_label("Bodies", exact=True).uncheck()
    assert shown.page.evaluate(TRIANGLES) == {"triangles": discs, "humans": False, "capsules": False}


@pytest.mark.slow
def test_take_without_people_draws_none(shown: Shown) -> None:
    shown.page.evaluate(
        """async (job) => {
          const { mount } = await import("/portal/viewer/mount.js");
          const { ApiSource } = await import("/portal/viewer/mount.js");
          const place = document.createElement("div");
          for (const child of document.body.children) child.hidden = true;
          document.body.prepend(place);
          const source = new ApiSource(job);
          const read = source.description.bind(source);
          source.description = async () => {
            const description = await read();
            description.people = [];
            description.strips.people = [];
            return description;
          };
          source.frames = async () => new ArrayBuffer(0);
          globalThis.viewer = await mount(place, source);
        }""",
        shown.job_ids[0],
    )
    expect(shown.page.locator(".look-viewer[data-ready=true]")).to_be_visible(timeout=180_000)
    expect(shown.page.get_by_text("This take has no people.")).to_be_visible()
    triangles = shown.page.evaluate(
        """() => {
          const { stage } = globalThis.viewer.view;
          stage.renderer.render(stage.scene, stage.camera);
          return stage.renderer.info.render.triangles;
        }"""
    )
    assert triangles == 0  # cameras, ground and axes are lines


@pytest.mark.slow
def test_keyboard_moves_play_head(shown: Shown) -> None:
    shown.mount()
    shown.page.locator(".look-canvas").focus()
    for key, expected in (("ArrowRight", 1), ("Shift+ArrowRight", 11), ("ArrowLeft", 10), ("End", 119), ("Home", 0)):
        shown.page.keyboard.press(key)
        assert shown.frame == expected, key
    shown.page.keyboard.press("2")
    expect(shown.page.get_by_label("View", exact=True).locator("option:checked")).to_have_text("Through b")
    assert shown.page.evaluate("() => globalThis.viewer.seen") == 1
    shown.page.keyboard.press("0")
    assert shown.page.evaluate("() => globalThis.viewer.seen") is None
    shown.page.keyboard.press("Space")
    expect(shown.page.get_by_role("button", name="Pause (Space)")).to_be_visible()
    shown.page.wait_for_function("() => globalThis.viewer.player.frame > 10")
    shown.page.keyboard.press("Space")
    expect(shown.page.get_by_role("button", name="Play (Space)")).to_be_visible()
    # In a field keys belong to the field.
    before = shown.frame
    shown.page.get_by_label("Speed").focus()
    shown.page.keyboard.press("End")
    assert shown.frame == before


def test_layout_is_remembered(shown: Shown) -> None:
    shown.mount()
    page = shown.page
    layout = page.get_by_label("Layout", exact=True)
    page.keyboard.press("v")
    expect(layout).to_have_value("scene")
    expect(page.locator(".look-wall")).to_be_hidden()
    page.keyboard.press("v")
    expect(page.locator(".look-tile:visible")).to_have_count(1)
    layout.select_option("b large")
    page.reload()
    shown.mount()
    expect(layout).to_have_value("camera:b")
    expect(page.get_by_role("button", name="Enlarge b")).to_have_attribute("aria-pressed", "true")
    page.get_by_role("button", name="Enlarge b").click()
    expect(layout).to_have_value("both")


def test_screen_is_filled_and_left(shown: Shown) -> None:
    shown.mount()
    page = shown.page
    page.get_by_role("button", name="b on the full screen").click()
    page.wait_for_function("() => document.fullscreenElement !== null")
    expect(page.locator(".look-view")).to_be_hidden()
    expect(page.locator(".look-tile:visible")).to_have_count(1)
    page.keyboard.press("Shift+F")
    page.wait_for_function("() => document.fullscreenElement === null")
    expect(page.locator(".look-view")).to_be_visible()
    expect(page.get_by_label("Layout", exact=True)).to_have_value("both")


def test_range_is_marked_and_plays_alone(shown: Shown) -> None:
    shown.mount()
    page = shown.page
    for key in ("Shift+ArrowRight", "i", "Shift+ArrowRight", "o", "Space"):
        page.keyboard.press(key)
    expect(page.locator(".look-span")).to_be_visible()
    found = page.evaluate(
        """async () => {
          const all = new Set();
          while (all.size < 6 || !all.has(20)) {
            await new Promise(requestAnimationFrame);
            all.add(globalThis.viewer.player.frame);
          }
          return [...all].sort((one, other) => one - other);
        }"""
    )
    assert set(found) <= set(range(10, 21))
    page.keyboard.press("x")
    expect(page.locator(".look-span")).to_be_hidden()
    box = page.locator(".look-strip").first.bounding_box()
    assert box is not None
    page.keyboard.down("Shift")
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 5)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"] + 1, box["y"] + 5)
    page.mouse.up()
    page.keyboard.up("Shift")
    assert page.evaluate("() => globalThis.viewer.player.span") == {"from": 60, "to": 90}
    # Without an editor there is nothing to trim.
    expect(page.get_by_role("button", name="Trim: keep this range of the take")).to_have_count(0)


def test_fit_frames_all_people(shown: Shown) -> None:
    shown.mount()
    for direction in ("top", "front", "side", None):
        extent = shown.page.evaluate(
            """(direction) => {
              const { viewer } = globalThis;
              viewer.fit(direction);
              const { view: { stage, people } } = viewer;
              stage.renderer.render(stage.scene, stage.camera);
              const box = people.boxAt(viewer.frame);
              const ends = [Infinity, -Infinity, Infinity, -Infinity];
              for (let corner = 0; corner < 8; corner++) {
                const point = box.min.clone();
                ["x", "y", "z"].forEach((axis, bit) => { if (corner >> bit & 1) point[axis] = box.max[axis]; });
                point.project(stage.camera);
                [ends[0], ends[1]] = [Math.min(ends[0], point.x), Math.max(ends[1], point.x)];
                [ends[2], ends[3]] = [Math.min(ends[2], point.y), Math.max(ends[3], point.y)];
              }
              return ends;
            }""",
            direction,
        )
        assert max(map(abs, extent)) <= 1, direction
        # People take most of the picture in one of its directions.
        assert max(extent[1] - extent[0], extent[3] - extent[2]) > 1.1, direction


@pytest.mark.slow
def test_two_jobs_side_by_side_share_play_head(shown: Shown) -> None:
    shown.mount(2)
    page = shown.page
    expect(page.locator(".look-viewer[data-ready=true]")).to_have_count(2)
    expect(page.get_by_role("region", name="Job 2")).to_be_visible()
    page.get_by_role("button", name="Last frame (End)").click()
    expect(page.get_by_role("slider", name="Play head").first).to_have_attribute(
        "aria-valuetext", "frame 119, 4.76 seconds"
    )
    assert page.evaluate("() => globalThis.viewer.player.frame") == 119


def test_missing_motion_is_reported(shown: Shown) -> None:
    job_id = shown.live.job_id()
    shown.live.finish(job_id)
    told = shown.page.evaluate(
        """async (job) => {
          const { mount } = await import("/portal/viewer/mount.js");
          const { ApiSource } = await import("/portal/viewer/mount.js");
          const source = new ApiSource(job);
          source.description = async () => { throw new Error("The job has no motion to look at."); };
          const place = document.createElement("div");
          document.body.append(place);
          await mount(place, source).catch(() => null);
          return place.textContent;
        }""",
        job_id,
    )
    assert told == "The job has no motion to look at."


@pytest.mark.slow
def test_sheets_that_scroll_are_reached_by_keyboard(live: Live, job_ids: list[str]) -> None:
    with opened(str(live.client.base_url), {"width": 390, "height": 844}) as page:
        page.emulate_media(color_scheme="dark", reduced_motion="reduce")
        Shown(page, live, job_ids).mount()
        page.locator("summary", has_text="Show").click()
        sheet = page.get_by_role("group", name="Show", exact=True)
        expect(sheet).to_be_visible()
        assert axe_findings(page, ".look-viewer") == []
        page.keyboard.press("Tab")
        expect(sheet).to_be_focused()
        page.keyboard.press("End")
        assert page.evaluate("() => globalThis.viewer.player.frame") == 0
        page.keyboard.press("Escape")
        expect(sheet).to_be_hidden()
        page.keyboard.press("?")
        keys = page.get_by_role("dialog", name="Keys")
        expect(keys.get_by_text("next layout")).to_be_visible()
        assert axe_findings(page, ".look-viewer") == []
        page.keyboard.press("End")
        assert page.evaluate("() => globalThis.viewer.player.frame") == 0
        page.keyboard.press("Escape")
        expect(keys).to_be_hidden()


def test_narrow_screens_need_no_sideways_scrolling(live: Live, job_ids: list[str]) -> None:
    with opened(str(live.client.base_url), {"width": 390, "height": 844}) as page:
        Shown(page, live, job_ids).mount()
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
        expect(page.get_by_role("button", name="Play (Space)")).to_be_visible()
