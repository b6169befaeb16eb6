"""Tool to correct joints in a real browser: by pointer in 3D and in pictures, and by keyboard."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page, expect

from tests.api.conftest import Live
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.viewer_pages import Shown, job_ids, live

__all__ = ["job_ids", "live"]

# Opens the tool with an editor that keeps the edits, which the tool previews as the page does.
OPEN = """async () => {
  const { JointTool } = await import("/portal/jobs/corrections/joint_tool.js");
  globalThis.edits = [];
  const editor = { add: (edit) => { globalThis.edits.push(edit); globalThis.tool.follow(globalThis.edits); } };
  globalThis.tool = new JointTool(globalThis.viewer, editor);
  globalThis.viewer.player.seek(40);
}"""

# Place of a joint of a person as it is shown, or beside it, in metres; and where the 3D view and cameras show it.
PLACE = """async ({ person, joint, beside }) => {
  const { positionsAt } = await import("/portal/viewer/motion/kinematics.js");
  const { prepareLens } = await import("/portal/viewer/video/overlay.js");
  const { viewer } = globalThis;
  const { joint_names: names, cameras } = viewer.description;
  const [out, next] = [0, 1].map(() => new Float32Array(3 * names.length));
  positionsAt(viewer.store, person, viewer.frame, "joints", out, next);
  const place = [...out.slice(3 * names.indexOf(joint), 3 * names.indexOf(joint) + 3)]
    .map((value, axis) => value + beside[axis]);
  const { stage, people } = viewer.view;
  const point = people.anchors[0].clone().set(...place);
  stage.toScreen(point.clone(), point);
  const { left, top } = viewer.canvas.getBoundingClientRect();
  const pictures = viewer.wall.tiles.map(({ camera, canvas }) => {
    const box = canvas.getBoundingClientRect();
    const scale = box.width / camera.size_px[0];
    const [u, v] = prepareLens(camera).project(...place, [0, 0]);
    return [box.left + (u + 0.5) * scale, box.top + (v + 0.5) * scale];
  });
  return { place, scene: [left + point.x, top + point.y], pictures };
}"""


@pytest.fixture
def shown(live: Live, job_ids: list[str]) -> Iterator[Shown]:
    with opened(str(live.client.base_url), {"width": 1600, "height": 1000}) as page:
        shown = Shown(page, live, job_ids)
        shown.mount()
        page.evaluate(OPEN)
        page.keyboard.press("c")
        expect(page.get_by_role("region", name="Correct joints")).to_be_visible()
        yield shown


def place_of(
    page: Page, joint: str = "left_elbow", person: int = 0, beside: tuple[float, ...] = (0, 0, 0)
) -> dict[str, Any]:
    return dict(page.evaluate(PLACE, {"person": person, "joint": joint, "beside": beside}))


def drag(page: Page, start: Sequence[float], by: Sequence[float] | NDArray[np.float64]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(start[0] + by[0] / 2, start[1] + by[1] / 2)
    page.mouse.move(start[0] + by[0], start[1] + by[1])
    page.mouse.up()


def edits(page: Page) -> list[dict[str, Any]]:
    return list(page.evaluate("globalThis.edits"))


def test_joint_is_dragged_on_plane_facing_view(shown: Shown) -> None:
    page = shown.page
    before = place_of(page, "right_wrist", 2)
    drag(page, before["scene"], (30, -20))
    (edit,) = edits(page)
    assert (edit["action"], edit["joint"], edit["frame"]) == ("key", "right_wrist", 40)
    after = place_of(page, "right_wrist", 2)
    # It is shown where it was let go, at once, and not nearer to the view.
    np.testing.assert_allclose(after["place"], edit["place_m"], atol=1e-5)
    np.testing.assert_allclose(np.subtract(after["scene"], before["scene"]), (30, -20), atol=1.5)
    towards = page.evaluate("""() => {
      const { camera } = globalThis.viewer.view.stage;
      return camera.getWorldDirection(camera.position.clone()).toArray();
    }""")
    assert abs(np.dot(np.subtract(after["place"], before["place"]), towards)) < 1e-4
    assert edit["person"] == 3


def test_two_pictures_place_joint_where_their_rays_meet(shown: Shown) -> None:
    page = shown.page
    page.get_by_label("Layout", exact=True).select_option("both")
    before, wanted = place_of(page), place_of(page, beside=(0.08, 0.05, -0.06))
    drag(page, before["pictures"][0], np.subtract(wanted["pictures"][0], before["pictures"][0]))
    between = place_of(page)
    np.testing.assert_allclose(between["pictures"][0], wanted["pictures"][0], atol=0.1)
    assert np.linalg.norm(np.subtract(between["place"], wanted["place"])) > 0.02
    drag(page, between["pictures"][1], np.subtract(wanted["pictures"][1], between["pictures"][1]))
    np.testing.assert_allclose(place_of(page)["place"], wanted["place"], atol=0.002)
    assert [edit["action"] for edit in edits(page)] == ["key", "key"]
    page.get_by_label("Drag", exact=True).select_option("detection")
    drag(page, place_of(page)["pictures"][2], (4, 0))
    last = edits(page)[-1]
    assert (last["action"], last["camera"], len(last["place_px"])) == ("place_detection", "c", 2)
    assert "place_m" not in last


def test_joint_is_dragged_along_ray_of_a_camera(shown: Shown) -> None:
    page = shown.page
    page.get_by_label("Drag", exact=True).select_option("b")
    before = place_of(page)
    drag(page, before["scene"], (25, 0))
    after = place_of(page)
    assert np.linalg.norm(np.subtract(after["place"], before["place"])) > 0.02
    np.testing.assert_allclose(after["pictures"][1], before["pictures"][1], atol=0.3)


def test_keys_and_ranges_are_set_by_keyboard(shown: Shown) -> None:
    page = shown.page
    tool = page.get_by_role("region", name="Correct joints")
    tool.get_by_label("Joint", exact=True).select_option("left_wrist")
    before = place_of(page, "left_wrist")["place"]
    field = tool.get_by_label("z", exact=True)
    field.fill(f"{before[2] + 0.1:.3f}")
    field.press("Enter")
    (edit,) = edits(page)
    assert (edit["action"], edit["joint"]) == ("key", "left_wrist")
    assert edit["place_m"][2] == pytest.approx(before[2] + 0.1, abs=1e-3)
    assert place_of(page, "left_wrist")["place"][2] == pytest.approx(before[2] + 0.1, abs=1e-3)
    origin_m = page.evaluate("() => globalThis.viewer.description.origin_m")
    leg_m = [place_of(page, f"right_{kind}")["place"] for kind in ("hip", "knee", "ankle")]
    right_m = (np.mean(leg_m, axis=0) + origin_m).tolist()
    page.locator(".look-canvas").focus()
    for key in ("i", "Shift+ArrowRight", "o"):
        page.keyboard.press(key)
    tool.get_by_label("Part", exact=True).select_option("left arm")
    tool.get_by_role("button", name="Ignore there").press("Enter")
    tool.get_by_label("Sides", exact=True).select_option("legs")
    tool.get_by_role("button", name="Exchange").press("Enter")
    tool.get_by_role("button", name="Does not stand").press("Enter")
    span = {"start_frame": 40, "stop_frame": 51}
    found = [{name: value for name, value in edit.items() if name != "person"} for edit in edits(page)[1:]]
    assert found == [
        {"action": "ignore_detections", "camera": "a", "part": "left_arm", **span},
        {"action": "exchange_sides", "part": "legs", "left_m": pytest.approx(right_m, abs=1e-5), **span},
        {"action": "contact", "limb": "left_foot", "stands": False, **span},
    ]
    assert axe_findings(page, ".look-viewer") == []
