"""Pages with the viewer of jobs, for tests in a real browser."""

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
from tests.api.conftest import Live, running
from tests.e2e.browsing import opened
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

# Frames of the video's picture, of the skeletons over it, and of the play head.
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
