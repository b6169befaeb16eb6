"""Speed of the viewer in a browser that draws in software, at up to 1920 x 1080 pixels."""

from pathlib import Path

import pytest
from playwright.sync_api import ViewportSize

from pipeline.core.options.config import Body
from pipeline.core.runtime.packages.samples import Sample
from pipeline.motion.body import installed
from tests.api.conftest import running
from tests.e2e.browsing import DESKTOP, opened
from tests.e2e.serving import serving
from tests.e2e.viewer_takes import crowd, quick_settings, viewer_files_of

pytestmark = pytest.mark.benchmark

MEASURE = """async ({ job, size: [width, height] }) => {
  const { mount } = await import("/portal/viewer/mount.js");
  const { ApiSource } = await import("/portal/viewer/mount.js");
  const place = document.createElement("div");
  for (const child of document.body.children) child.hidden = true;
  document.body.prepend(place);
  const view = () => place.querySelector(".look-view");
  const start = performance.now();
  const viewer = await mount(place, new ApiSource(job));
  Object.assign(view().style, { position: "fixed", inset: "0", width: `${width}px`, height: `${height}px`, zIndex: 9 });
  while (place.querySelector("[data-ready]") === null) await new Promise(requestAnimationFrame);
  const readyMs = performance.now() - start;
  viewer.fit();
  viewer.player.play();
  const settled = () => new Promise((resolve) => setTimeout(resolve, 5000));
  await settled();
  const { render } = viewer.view.stage.renderer.info;
  const before = { frame: render.frame, at: performance.now() };
  await settled();
  const seconds = (performance.now() - before.at) / 1000;
  const found = {
    readyMs, framesPerSecond: (render.frame - before.frame) / seconds, calls: render.calls,
    width: viewer.canvas.width, height: viewer.canvas.height, keptBytes: viewer.store.numBytes,
    playedFrames: viewer.player.frame,
  };
  viewer.close();
  return found;
}"""

# Plays at once, and again when the pictures are kept; then moves the play head 40 times and waits for all pictures.
WITH_VIDEOS = """async ({ job, cameras }) => {
  const { mount } = await import("/portal/viewer/mount.js");
  const { ApiSource } = await import("/portal/viewer/mount.js");
  const place = document.createElement("div");
  for (const child of document.body.children) child.hidden = true;
  document.body.prepend(place);
  place.style.setProperty("--above", "2rem"); // fills the window
  const viewer = await mount(place, new ApiSource(job, cameras));
  const { player, wall: { tiles } } = viewer;
  const frame = () => new Promise(requestAnimationFrame);
  while (!tiles.every((tile) => tile.isInTake)) await frame();
  const { render } = viewer.view.stage.renderer.info;
  const play = async (seconds) => {
    const [start, before] = [performance.now(), render.frame];
    const shown = tiles.map((tile) => ({ at: tile.shownS, count: 0 }));
    while (performance.now() - start < 1000 * seconds) {
      await frame();
      tiles.forEach(({ shownS }, number) => {
        if (shown[number].at !== shownS) shown[number] = { at: shownS, count: shown[number].count + 1 };
      });
    }
    const elapsedS = (performance.now() - start) / 1000;
    const picturesPerSecond = shown.map(({ count }) => count / elapsedS);
    return { framesPerSecond: (render.frame - before) / elapsedS, picturesPerSecond };
  };
  player.play();
  const [first, then] = [await play(4), await play(6)];
  player.pause();
  const start = performance.now();
  for (let step = 0; step < 40; step++) {
    player.seek((step * 37 + 11) % player.numFrames);
    const isThere = ({ shownS }) => Math.abs(shownS - player.timeS) < 1.01 / player.rateHz;
    do await frame(); while (!tiles.every(isThere));
  }
  const found = { first, then, scrubbedS: (performance.now() - start) / 1000 };
  viewer.close();
  return found;
}"""


FULL_HD: ViewportSize = {"width": 1920, "height": 1080}


@pytest.mark.parametrize(("body", "size"), [("human", (1280, 720)), ("capsules", (1280, 720)), ("human", (1920, 1080))])
def test_ten_people_and_ten_thousand_frames(body: Body, size: tuple[int, int], tmp_path: Path) -> None:
    installed.install()
    files = viewer_files_of(crowd(10, 10_000), installed.load() if body == "human" else None)
    with running(quick_settings(tmp_path)) as live:
        job_id = live.job_id()
        live.finish(job_id, motion=files)
        with opened(str(live.client.base_url), FULL_HD) as page:
            found = page.evaluate(MEASURE, {"job": job_id, "size": size})
    print({"body": body, "size": size, **{name: len(content) for name, content in files.items()}, **found})  # noqa: T201 - a benchmark's result
    assert found["calls"] <= 10
    assert found["keptBytes"] <= 64 * 2**20
    assert found["readyMs"] <= 3000
    assert found["framesPerSecond"] >= 30


@pytest.mark.parametrize("viewport", [DESKTOP, FULL_HD])
def test_sample_is_shown_with_its_videos(viewport: ViewportSize, tmp_path: Path, sample: Sample) -> None:
    with serving(tmp_path / "data") as served:
        job = served.wait_for_end(served.post(sample))
        session = served.client.get(job["urls"]["session"]).json()
        with opened(str(served.client.base_url), viewport) as page:
            cameras = session["preflight"]["cameras"]
            found = page.evaluate(WITH_VIDEOS, {"job": job["id"], "cameras": cameras})
    print(viewport, found)  # noqa: T201 - a benchmark's result
    assert found["then"]["framesPerSecond"] >= 24
    assert min(found["then"]["picturesPerSecond"]) >= 24
    assert found["scrubbedS"] <= 4
