"""Points of the user's own in the viewer: balls and names where the points are, hidden with their person; bones."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect

from pipeline.core.data.own_points import OwnTracks, SceneObject
from pipeline.core.data.people import Track3D
from pipeline.core.joints import COCO_17
from tests.api.conftest import Live, running
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.viewer_takes import crowd, quick_settings, viewer_files_of

NUM_FRAMES = 40
UNKNOWN = range(20, 30)

MOUNT = """async (job) => {
  const { mount, ApiSource } = await import("/portal/viewer/mount.js");
  const place = document.createElement("div");
  for (const child of document.body.children) child.hidden = true;
  document.body.prepend(place);
  globalThis.viewer = await mount(place, new ApiSource(job, []));
}"""

# World positions of the balls of a frame; null of hidden ones.
PLACES = """async (frame) => {
  const { Matrix4, Vector3 } = await import("/portal/vendor/three/three.module.js");
  const { view } = globalThis.viewer;
  globalThis.viewer.goTo(frame);
  return view.points.points.map((_, number) => {
    const matrix = new Matrix4();
    view.points.balls.getMatrixAt(number, matrix);
    return matrix.elements[0] === 0 ? null : new Vector3().setFromMatrixPosition(matrix).toArray();
  });
}"""

# Ends of the lines of bones in a frame, which `PLACES` has shown.
ENDS = """() => [...globalThis.viewer.view.points.lines.geometry.getAttribute("position").array]"""


def points_at(xyz_m: np.ndarray) -> Track3D:
    shape = xyz_m.shape[:2]
    source, views = np.ones(shape, np.int8), np.full(shape, 3)
    return Track3D(0, 0, xyz_m, np.ones(shape), source, np.zeros(shape), views, np.zeros(shape))


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    with running(quick_settings(tmp_path_factory.mktemp("points"))) as service:
        yield service


def test_points_are_drawn_where_they_are(live: Live, tmp_path: Path) -> None:
    take = crowd(2, NUM_FRAMES, 25.0)
    wrist = COCO_17.index("right_wrist")
    tips = tuple(points_at(track.xyz_m[:, [wrist]] + [0.0, 0.0, 0.4]) for track in take.tracks)
    angle = np.arange(NUM_FRAMES) / 6.0
    ball_m = np.stack([np.sin(angle), np.cos(angle) + 1.0, 1.5 + 0.3 * np.sin(2 * angle)], axis=-1)
    ball_m[UNKNOWN.start : UNKNOWN.stop] = np.nan
    ball = SceneObject("match_ball", ("match_ball",), points_at(ball_m[:, None]))
    job_id = live.job_id()
    kite_m = ball_m[:, None] + np.array([[0.0, 0.0, 0.5], [0.3, 0.0, 0.6]])
    kite = SceneObject("kite", ("nose", "tail"), points_at(kite_m), (("nose", "tail"),))
    own = OwnTracks(("racket_tip",), tips, (ball, kite))
    live.finish(job_id, motion=viewer_files_of(replace(take, own=own)))
    with opened(str(live.client.base_url)) as page:
        page.evaluate(MOUNT, job_id)
        expect(page.locator(".look-viewer[data-ready=true]")).to_be_visible(timeout=180_000)
        for frame in (0, 13, 25):
            places = page.evaluate(PLACES, frame)
            expected = [*(tip.xyz_m[frame, 0] for tip in tips), ball_m[frame], *kite_m[frame]]
            ends = np.nan_to_num(kite_m[frame]).ravel()  # a bone that is unknown has no length
            np.testing.assert_allclose(page.evaluate(ENDS), ends, atol=2e-3)
            assert [place is None for place in places] == [bool(np.isnan(xyz_m).any()) for xyz_m in expected]
            for place, xyz_m in zip(places, expected, strict=True):
                if place is not None:
                    np.testing.assert_allclose(place, xyz_m, atol=2e-3)
        expect(page.locator(".look-label-point", has_text="match ball")).to_be_hidden()
        page.evaluate(PLACES, 13)
        expect(page.locator(".look-label-point", has_text="match ball")).to_be_visible()
        assert not axe_findings(page, ".look-labels")
        if folder := os.environ.get("MULTICAP_PICTURES"):
            page.screenshot(path=str(Path(folder) / "own_points.png"))
        page.evaluate("globalThis.viewer.view.setShown(0, false)")
        assert [place is None for place in page.evaluate(PLACES, 13)] == [True, *[False] * 4]
