"""Viewer in a real browser: drawing, keyboard, strips, plots, videos in step, pairs, problems."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from pipeline.core.data.people import Doubt
from pipeline.motion.body import installed
from pipeline.motion.body.makehuman import NUM_COARSE_TRIANGLES
from tests.api.conftest import Live, running
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.viewer_takes import crowd, quick_settings, viewer_files_of
from tests.pipeline.media import write_pictures

NUM_FRAMES, RATE_HZ = 120, 25
# Numbers of frames are drawn as bits: columns of this width, black or white.
BITS, BIT_PX, HEIGHT_PX = 8, 40, 180

MOUNT = """async ({ jobs, clock, video, clocks, person }) => {
  const { mount, mountPair } = await import("/portal/viewer/mount.js");
  const { ApiSource } = await import("/portal/viewer/mount.js");
  const place = document.createElement("div");
  for (const child of document.body.children) child.hidden = true;
  document.body.prepend(place);
  const sources = jobs.map((job) => {
    const source = new ApiSource(job);
    const read = source.description.bind(source);
    // The service's session has no real videos: the first camera gets one.
    source.description = async () => {
      const description = await read();
      if (clock !== null) Object.assign(description.cameras[0], { clock, size_px: [320, 180], video: "a.mp4" });
      if (clocks !== null) description.clocks = clocks;
      if (person !== null) Object.assign(description.people[0], person);
      return description;
    };
    source.video = async (camera) => (camera.name === "a" && video !== null ? { url: video, startS: 0 } : null);
    return source;
  });
  const titles = jobs.map((_, number) => `Job ${number + 1}`);
  globalThis.viewer = jobs.length === 1 ? await mount(place, sources[0]) : await mountPair(place, sources, titles);
}"""

# Frame that the video's picture shows, that of the skeletons over it, and that of the play head.
PICTURE = """() => {
  const { viewer } = globalThis;
  const tile = viewer.wall.tiles[0];
  globalThis.sheet ??= Object.assign(document.createElement("canvas"), { width: 320, height: 180 });
  const context = globalThis.sheet.getContext("2d", { willReadFrequently: true });
  // What the tile shows: without a graphics card the canvas has the picture, below the skeletons.
  context.drawImage(tile.video, 0, 0, 320, 180);
  context.drawImage(tile.canvas, 0, 0, 320, 180);
  let number = 0;
  for (let bit = 0; bit < 8; bit++) {
    number += (context.getImageData(20 + 40 * bit, 90, 1, 1).data[0] > 127 ? 1 : 0) << bit;
  }
  const rate = 25;
  return { picture: number, overlay: Math.round(tile.shownS * rate), head: Math.round(viewer.player.timeS * rate) };
}"""


@dataclass
class Shown:
    """Page with the viewer of jobs of a running service."""

    page: Page
    live: Live
    job_ids: list[str]

    def mount(
        self,
        count: int = 1,
        *,
        clock: list[Any] | None = None,
        video: Path | None = None,
        clocks: list[dict[str, Any]] | None = None,
        person: dict[str, Any] | None = None,
    ) -> None:
        address = None
        if video is not None:
            address = f"/{video.name}"
            self.page.route(f"**{address}", lambda route: send_part(route, video.read_bytes()))
        jobs = self.job_ids[:count]
        choices = {"clock": clock, "video": address, "clocks": clocks, "person": person}
        self.page.evaluate(MOUNT, {"jobs": jobs, **choices})
        expect(self.page.locator(".look-viewer[data-ready=true]").first).to_be_visible(timeout=180_000)

    @property
    def frame(self) -> int:
        return int(self.page.evaluate("() => globalThis.viewer.player.frame"))


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    with running(quick_settings(tmp_path_factory.mktemp("viewer"))) as service:
        yield service


@pytest.fixture(scope="module")
def job_ids(live: Live) -> list[str]:
    take = crowd(3, NUM_FRAMES, float(RATE_HZ), doubts=((), (Doubt(60, 0.7, 1),), ()))
    installed.install()
    files = viewer_files_of(take, installed.load())
    found = []
    for _ in range(2):
        found.append(live.job_id())
        live.finish(found[-1], motion=files)
    return found


@pytest.fixture
def shown(live: Live, job_ids: list[str]) -> Iterator[Shown]:
    with opened(str(live.client.base_url)) as page:
        yield Shown(page, live, job_ids)


@pytest.fixture(scope="module")
def numbered_video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "numbered.mp4"
    return write_pictures(path, numbers(), {"g": "15", "crf": "12"})


@pytest.fixture(scope="module")
def fragmented_video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Such a video in fragments, which the browser's player shows."""
    whole = tmp_path_factory.mktemp("video") / "whole.mp4"
    write_pictures(whole, numbers(), {"g": "15", "crf": "12", "bf": "0"})
    path = whole.with_name("fragmented.mp4")
    with (
        av.open(str(whole)) as reader,
        av.open(str(path), "w", options={"movflags": "frag_keyframe+empty_moov"}) as writer,
    ):
        stream = writer.add_stream_from_template(reader.streams.video[0])
        for packet in reader.demux(video=0):
            if packet.size:
                packet.stream = stream
                writer.mux(packet)
    return path


def numbers() -> list[np.ndarray]:
    """Pictures with their numbers as columns of black and white."""
    images = []
    for number in range(NUM_FRAMES):
        columns = [255 * (number >> bit & 1) for bit in range(BITS)]
        row = np.repeat(np.array(columns, np.uint8), BIT_PX)
        images.append(np.repeat(np.broadcast_to(row, (HEIGHT_PX, len(row)))[..., None], 3, axis=2))
    return images


def send_part(route: Route, content: bytes) -> None:
    """Answer a request for a range of a file."""
    first, _, last = route.request.headers.get("range", "bytes=0-").removeprefix("bytes=").partition("-")
    part = content[int(first) : int(last) + 1 if last else None]
    span = f"bytes {first}-{int(first) + len(part) - 1}/{len(content)}"
    headers = {"Content-Range": span, "Accept-Ranges": "bytes", "Content-Type": "video/mp4"}
    route.fulfill(status=206 if part else 416, headers=headers, body=part)


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
    fields = ("person", "kind", "start_frame", "stop_frame")
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
    page.get_by_role("button", name="One frame forward (Right)").click()
    page.wait_for_function(f"() => {{ const [width, full] = ({widths})(); return width < 0.8 * full; }}", polling=5)


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
