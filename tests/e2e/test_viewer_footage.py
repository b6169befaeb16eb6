"""Viewer in a real browser: footage behind bodies, videos in step, strips and plots."""

import re
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.e2e.viewer_pages import (
    NUM_FRAMES,
    PICTURE,
    RATE_HZ,
    Shown,
    fragmented_video,
    job_ids,
    live,
    numbered_video,
    shown,
)

__all__ = ["fragmented_video", "job_ids", "live", "numbered_video", "shown"]

# A red ball near a corner of the picture of a camera with a lens: where it is drawn, and where the lens model puts it.
BALL = """async ({ lens, distortion }) => {
  const THREE = await import("/portal/vendor/three/three.module.js");
  const { prepareLens } = await import("/portal/viewer/video/overlay.js");
  const { view, description } = globalThis.viewer;
  const camera = Object.assign(description.cameras[0], { lens, distortion });
  const { stage } = view;
  view.apply({ body: false, trails: false, contacts: false, names: false });
  const [width, height] = camera.size_px;
  const [a, b, c] = prepareLens({ ...camera, lens: "standard", distortion: [] }).ray(0.2 * width, 0.2 * height);
  const { rotation: r, translation_m: t } = camera.cam_from_world;
  const point = [a, b, c].map((way, axis) => 3 * way - (r[0][axis] * t[0] + r[1][axis] * t[1] + r[2][axis] * t[2]));
  const ball = new THREE.Mesh(new THREE.SphereGeometry(0.03), new THREE.MeshBasicMaterial({ color: 0xff0000 }));
  ball.position.set(...point);
  stage.add(ball);
  view.see(0);
  stage.renderer.render(stage.scene, stage.camera);
  const { width: wide, height: high } = stage.canvas;
  const sheet = Object.assign(document.createElement("canvas"), { width: wide, height: high });
  const context = sheet.getContext("2d");
  context.drawImage(stage.canvas, 0, 0);
  const { data } = context.getImageData(0, 0, sheet.width, sheet.height);
  let [count, x, y] = [0, 0, 0];
  for (let place = 0; place < data.length; place += 4) {
    if (data[place] < 200 || data[place + 1] > 60) continue;
    count += 1;
    x += (place / 4) % sheet.width;
    y += Math.floor(place / 4 / sheet.width);
  }
  const scale = Math.max(width / wide, height / high);
  const drawn = [
    (x / count + 0.5 - wide / 2) * scale + width / 2 - 0.5, (y / count + 0.5 - high / 2) * scale + height / 2 - 0.5,
  ];
  const model = prepareLens(camera).project(...point, [0, 0]);
  const isOn = stage.toScreen(ball.position, new THREE.Vector3());
  return { drawn, model, straight: [0.2 * width, 0.2 * height], scale, isOn };
}"""


@pytest.mark.parametrize(
    ("lens", "distortion"),
    [
        ("standard", [-0.28, 0.09, 0.01, -0.02, 0.01, 0.1, 0.02, 0.003, 0.004, -0.002, 0.003, 0.001]),
        ("fisheye", [0.03, -0.004, 0.001, -0.0002]),
    ],
)
def test_view_through_camera_is_bent_by_its_lens(shown: Shown, lens: str, distortion: list[float]) -> None:
    shown.mount()
    found = shown.page.evaluate(BALL, {"lens": lens, "distortion": distortion})
    assert found["isOn"]
    off_px = np.subtract(found["drawn"], found["model"])
    assert np.abs(off_px).max() < found["scale"]
    # Without a lens the ball would be elsewhere.
    assert np.hypot(*np.subtract(found["straight"], found["model"])) > 5 * found["scale"]


def test_bodies_are_over_the_footage_of_their_camera(shown: Shown, numbered_video: Path) -> None:
    clock = [[0, 0.0, 0.0], [NUM_FRAMES - 1, (NUM_FRAMES - 1) / RATE_HZ, (NUM_FRAMES - 1) / RATE_HZ]]
    shown.mount(clock=clock, video=numbered_video)
    page = shown.page
    page.wait_for_function("() => globalThis.viewer.wall.tiles[0].isInTake")
    page.keyboard.press("1")
    page.wait_for_function("() => globalThis.viewer.hasFootage")
    behind = page.locator(".look-view > .look-picture")
    box, scene = behind.bounding_box(), page.locator(".look-view").bounding_box()
    assert box is not None
    assert scene is not None
    # The picture is as large as fits, amid the view, as the projection assumes.
    assert box["width"] / box["height"] == pytest.approx(320 / 180, rel=0.01)
    assert min(scene["width"] - box["width"], scene["height"] - box["height"]) == pytest.approx(0, abs=1.5)
    assert box["x"] + box["width"] / 2 == pytest.approx(scene["x"] + scene["width"] / 2, abs=1.5)
    page.keyboard.press("0")
    expect(behind).to_have_count(0)
    expect(page.locator(".look-tile .look-picture")).to_have_count(len(page.locator(".look-tile").all()))


@pytest.mark.slow
def test_strips_lead_to_doubtful_spots(shown: Shown) -> None:
    shown.mount()
    concerns = shown.page.evaluate("() => globalThis.viewer.description.concerns")
    (number,) = [number for number, concern in enumerate(concerns) if concern["kind"] == "identity"]
    for _ in range(number + 1):
        shown.page.get_by_role("button", name="Next place to look at (N)").click()
    assert shown.frame == 54
    words = "person-2, frame 54. The person may be another one from frame 60 on."
    expect(shown.page.locator(".look-status")).to_contain_text(words)
    strip = shown.page.get_by_role("img", name="person-1: 100 % of the joints measured")
    box = strip.bounding_box()
    assert box is not None
    shown.page.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + 5)
    assert abs(shown.frame - 90) <= 1
    place = shown.page.get_by_role("slider", name="Play head")
    place.focus()
    shown.page.keyboard.press("ArrowLeft")
    assert abs(shown.frame - 89) <= 1


def test_places_to_look_at_are_visited_and_accepted(shown: Shown) -> None:
    shown.mount()
    page = shown.page
    page.evaluate("""() => {
      globalThis.edits = [];
      globalThis.viewer.editor = { add: (edit) => globalThis.edits.push(edit) };
    }""")
    concerns = page.evaluate("() => globalThis.viewer.description.concerns")
    worst = concerns[0]
    page.keyboard.press("n")
    assert shown.frame == worst["start_frame"]
    status = page.locator(".look-status")
    expect(status).to_contain_text(f"1 of {len(concerns)}: person-{worst['person']}, frame {worst['start_frame']}.")
    expect(status).to_contain_text(worst["message"])
    for number in range(len(concerns)):
        page.keyboard.press("y")
        if number + 1 < len(concerns):
            expect(status).to_contain_text(f"1 of {len(concerns) - number - 1}: ")
    expect(status).to_have_text("No place is left to look at.")
    fields = ("person", "camera", "kind", "start_frame", "stop_frame")
    accepted = [{"action": "accept", **{name: concern[name] for name in fields}} for concern in concerns]
    assert page.evaluate("() => globalThis.edits") == accepted


@pytest.mark.slow
def test_figures_and_plots(shown: Shown) -> None:
    shown.mount()
    people = shown.page.get_by_role("table", name="People")
    expect(people.get_by_role("row")).to_have_count(4)
    people.get_by_role("button", name="70 % at 60").click()
    assert shown.frame == 60
    people_tab = shown.page.get_by_role("tab", name="People")
    people_tab.focus()
    shown.page.keyboard.press("ArrowRight")
    expect(shown.page.get_by_role("tab", name="Plots")).to_be_focused()
    for kind, label, count in (
        ("cameras", "a", 3),
        ("joints", "left wrist", 17),
        ("angles", "Left knee", 6),
        ("angles-knee", "right knee flexion", 2),
        ("angles-hip", "left hip adduction", 6),
        ("speeds", "hips", 5),
    ):
        shown.page.get_by_label("Plot", exact=True).select_option(kind)
        expect(shown.page.locator(".u-legend .u-series")).to_have_count(count + 1)
        expect(shown.page.locator(".u-legend .u-label", has_text=label).first).to_be_visible()
    shown.page.get_by_label("Plot", exact=True).select_option("angles")
    # The walker's elbows are bent by 0.9 rad all the time.
    expect(shown.page.locator(".u-series", has_text="Left elbow").locator(".u-value")).to_have_text("52 °")
    shown.page.get_by_label("Plot", exact=True).select_option("angles-elbow")
    expect(shown.page.locator(".u-series", has_text="left elbow flexion").locator(".u-value")).to_have_text("52 °")


@pytest.mark.parametrize("kind", ["numbered_video", pytest.param("fragmented_video", marks=pytest.mark.slow)])
def test_video_and_skeleton_are_in_step(shown: Shown, kind: str, request: pytest.FixtureRequest) -> None:
    clock = [[0, 0.0, 0.0], [NUM_FRAMES - 1, (NUM_FRAMES - 1) / RATE_HZ, (NUM_FRAMES - 1) / RATE_HZ]]
    shown.mount(clock=clock, video=request.getfixturevalue(kind))
    page = shown.page
    page.wait_for_function("() => globalThis.viewer.wall.tiles[0].isInTake")
    is_decoded = page.evaluate("() => globalThis.viewer.wall.tiles[0].numDecoded > 0")
    assert is_decoded == (kind == "numbered_video")
    # The skeletons would lie over the bits of the numbers.
    for box in page.get_by_role("checkbox", name=re.compile("^Show person-")).all():
        box.uncheck()
    for frame in (0, 1, 37, 38, 119, 64):
        page.evaluate("(frame) => globalThis.viewer.player.seek(frame)", frame)
        settled = (
            f"() => {{ const found = ({PICTURE})(); return found.picture === {frame} && found.overlay === {frame}; }}"
        )
        page.wait_for_function(settled, timeout=180_000)
    page.evaluate("() => { globalThis.viewer.player.seek(0); globalThis.viewer.player.play(); }")
    page.wait_for_function("() => globalThis.viewer.player.frame > 15")
    found = page.evaluate(
        f"""async () => {{
          const all = [];
          for (let count = 0; count < 60; count++) {{
            await new Promise(requestAnimationFrame);
            all.push(({PICTURE})());
          }}
          return all;
        }}"""
    )
    assert len({one["picture"] for one in found}) > 10
    # Samples around the jump from the end to the start tell nothing.
    inside = [one for one in found if 5 < one["head"] < NUM_FRAMES - 5 and 5 < one["picture"] < NUM_FRAMES - 5]
    assert len(inside) > 30
    # A busy machine takes long between two samples, and the picture moves on while it is read: so not every one counts.
    for other in ("overlay", "head"):
        off = np.array([abs(one["picture"] - one[other]) for one in inside])
        assert np.percentile(off, 75) <= 1, (other, off.tolist())


@pytest.mark.slow
def test_no_picture_is_decoded_twice(shown: Shown, numbered_video: Path) -> None:
    clock = [[0, 0.0, 0.0], [NUM_FRAMES - 1, (NUM_FRAMES - 1) / RATE_HZ, (NUM_FRAMES - 1) / RATE_HZ]]
    shown.mount(clock=clock, video=numbered_video)
    page = shown.page
    # At rest the pictures ahead are decoded, each once.
    decoded = "globalThis.viewer.wall.tiles[0].numDecoded"
    page.wait_for_function(f"() => {decoded} >= {NUM_FRAMES}", timeout=180_000)
    page.get_by_role("button", name="Play (Space)").click()
    page.wait_for_function("() => globalThis.viewer.player.frame > 60")
    page.wait_for_function("() => globalThis.viewer.player.frame < 30")
    page.get_by_role("button", name="Pause (Space)").click()
    for frame in (100, 3, 64):
        page.evaluate("(frame) => globalThis.viewer.player.seek(frame)", frame)
        page.wait_for_function(f"() => Math.round(globalThis.viewer.wall.tiles[0].shownS * {RATE_HZ}) === {frame}")
    assert page.evaluate(f"() => {decoded}") == NUM_FRAMES
    # An enlarged picture has other pixels.
    page.get_by_role("button", name="Enlarge a").click()
    page.wait_for_function(f"() => {decoded} > {NUM_FRAMES}")


@pytest.mark.slow
def test_all_pixels_are_drawn_again_at_rest(shown: Shown) -> None:
    shown.mount()
    page = shown.page
    # A machine that is slow: pictures come 100 ms apart.
    page.evaluate(
        """() => {
          const { stage, people } = globalThis.viewer.view;
          for (let picture = 0; picture < 40; picture++) {
            people.show(picture);
            stage.draw(10_000 + 100 * picture);
          }
        }"""
    )
    widths = """() => {
      const { canvas } = globalThis.viewer;
      return [canvas.width, Math.floor(canvas.clientWidth * devicePixelRatio)];
    }"""
    width, full = page.evaluate(widths)
    assert width < 0.8 * full
    page.wait_for_function(f"() => {{ const [width, full] = ({widths})(); return width === full; }}")
    # The next picture that changes is drawn with fewer pixels at once.
    page.evaluate(
        """() => {
          const { canvas } = globalThis.viewer;
          globalThis.widths = [];
          new MutationObserver(() => widths.push(canvas.width)).observe(canvas, { attributeFilter: ["width"] });
        }"""
    )
    page.get_by_role("button", name="One frame forward (Right)").click()
    page.wait_for_function(f"() => widths.some((width) => width < 0.8 * {full})")
