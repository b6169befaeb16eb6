"""New capture sends the capture that it shows, at whatever moment of a pending request Send is pressed."""

import base64
import json
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, Request, Route, expect
from playwright.sync_api import TimeoutError as PageTimeoutError

from pipeline.calibration.write import encode, encode_toml
from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.browsing import choose_option, opened
from tests.e2e.captures import cameras_of_two_videos, keypoint_capture, two_videos
from tests.e2e.serving import Served
from tests.e2e.test_serve_keypoints import archives

# Apart from the other tests of the page, which take long enough one after the other.
pytestmark = pytest.mark.xdist_group("waits")

# Texts of the capture on the page.
SHOWN = """() => {
  const text = (selector) => document.querySelector(selector)?.innerText ?? null;
  const value = (selector) => document.querySelector(selector)?.value ?? null;
  const rows = [...document.querySelectorAll(".files tbody tr:not(.of-camera)")].map((row) => {
    const field = (start) => row.querySelector(`[aria-label^="${start}"]`);
    return {
      file: row.querySelector(".file b").innerText, is_used: field("Use ").checked, camera: field("Camera of")?.value ?? null,
      offset_s: Number(field("Offset")?.value ?? 0), rate: Number(field("Frame rate")?.value ?? 0) || null,
    };
  });
  const choices = {};
  for (const input of document.querySelectorAll("[name^=send-]")) {
    const name = input.name.slice("send-".length);
    if (input.type === "radio") { if (input.checked) choices[name] = input.value; } else if (input.type === "checkbox") {
      if (input.checked) choices[name] = [...(choices[name] ?? []), input.value];
    } else if (input.value !== "") choices[name] = input.value;
  }
  return {
    calibration: text(".chosen b"), name: value("[name=name]"), rows: rows.filter((row) => row.is_used), choices,
    clock: [...document.querySelectorAll(".clock")].find((one) => one.innerText.startsWith("The videos start"))?.querySelector("select").value ?? null,
    rate_hz: Number([...document.querySelectorAll(".clock")].find((one) => one.innerText.startsWith("Frame rate"))?.querySelector("input").value ?? 0) || null,
  };
}"""  # noqa: E501

# Id of the calibration in the draft that the browser keeps.
STORED = """() => JSON.parse(localStorage.getItem("multicap.draft"))?.calibrationId ?? null"""

SESSIONS, JOBS = "POST /v1/sessions", "POST /v1/sessions/ID/jobs"
# The refusal of a file, the icon of the address that clears the browser's memory, and too many requests in a minute.
ALLOWED = ("422 (Unprocessable", "404 (Not Found", "429 (Too Many")
# Requests of the frame of the page, which have nothing to do with the form.
OF_FRAME = {"GET /v1/caller", "GET /v1/jobs", "GET /v1/jobs/ID/events"}


def job_kind(request: Request) -> str:
    """Method and path of a request to the service, without ids."""
    path = re.sub(r"https?://[^/]+", "", request.url).partition("?")[0]
    return f"{request.method} {re.sub(r'[0-9a-f]{8}-[0-9a-f-]{27,}', 'ID', path)}"


@dataclass
class Run:
    """One use of the form: keeps back one of its requests, and never answers the last one.

    Parameters
    ----------
    kept
        Kind and number of the request to keep back, from 1; ``None``: none.
    last
        Kind of the request that is never answered: the page stands as it was when it sent it.
    is_busy
        True if the service answers the request that was kept back that it is busy.
    """

    page: Page
    kept: tuple[str, int] | None
    last: str
    is_busy: bool = False
    seen: list[tuple[str, int]] = field(default_factory=list)
    held: Route | None = None
    was_held: bool = False
    is_held_early: bool = False  # whether an action followed while it was kept back
    bodies: dict[str, list[dict[str, Any]]] = field(default_factory=lambda: {SESSIONS: [], JOBS: []})
    is_pressed: bool = False
    is_as_meant: bool = True  # whether all actions could be done
    _numbers: Counter[str] = field(default_factory=Counter)
    _keys: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        """Open the form as a browser that has never seen the page."""
        self.page.unroute_all(behavior="ignoreErrors")
        self.page.goto("/portal/icon.svg")
        self.page.evaluate("localStorage.clear()")
        self.page.route("**/v1/**", self._handle)
        self.page.goto("/#/new")
        expect(self._send()).to_be_visible(timeout=180_000)

    def _handle(self, route: Route) -> None:
        kind = job_kind(route.request)
        self._numbers[kind] += 1
        self.seen.append((kind, self._numbers[kind]))
        if kind in self.bodies and (key := route.request.headers["idempotency-key"]) not in self._keys:
            self._keys.add(key)  # a busy service is asked again with the same key
            self.bodies[kind].append(dict(route.request.post_data_json or {}))
        if kind == self.last:
            return
        if self.seen[-1] == self.kept:
            self.held, self.was_held = route, True
        else:
            route.continue_()

    def _send(self) -> Locator:
        return self.page.get_by_role("button", name="Send and reconstruct")

    def press(self) -> None:
        if self._send().count():
            self._send().click(force=True)
        self.is_pressed = True

    def release(self) -> None:
        if self.held is not None and self.is_busy:
            problem = {"code": "too_many_checks", "detail": "Too many of your captures are being checked at once."}
            self.held.fulfill(status=429, json=problem)
        elif self.held is not None:
            self.held.continue_()
        self.held = None

    def wait(self, condition: Callable[[], object]) -> None:
        for _ in range(1200):
            if condition():
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"nothing happened while {self.kept} was kept back")

    def is_sent(self) -> bool:
        """Return whether the last request was made."""
        return bool(self.bodies[self.last])

    def is_refused(self) -> bool:
        """Return whether the page says why it does not send; while it waits for a busy service, it still sends."""
        return self._refusal().count() > 0 and self.page.locator(".go [type=submit][aria-disabled=true]").count() == 0

    def refusals(self) -> list[str]:
        """Reasons for which the page does not send."""
        return self._refusal().all_inner_texts()

    def _refusal(self) -> Locator:
        return self.page.get_by_role("region", name="Send").get_by_role("alert")

    def choose_stored(self, name: str) -> None:
        """Choose a calibration; not before the list of them is there."""
        options = self.page.get_by_label("Stored calibration")
        self.wait(lambda: self.held or name in options.inner_text())
        self.is_as_meant &= name in options.inner_text() and self._is_chosen(options, name)

    def _is_chosen(self, options: Locator, name: str) -> bool:
        """Choose an option; whether that was possible: once Send was pressed, the form may be locked."""
        if self.is_pressed and not options.is_enabled():
            return False
        try:
            choose_option(options, name)
        except PageTimeoutError:
            assert self.is_pressed
            return False
        return True

    def choose(self, *paths: Path) -> None:
        self.page.get_by_label("Choose files").set_input_files(paths)


Action = Callable[[Run], None]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two videos, two calibrations of their cameras, and two zips of keypoints."""
    folder = tmp_path_factory.mktemp("waits")
    paths = two_videos(folder)
    for name, turn in (("first", 0.3), ("second", 0.5), ("third", 0.7)):
        paths[f"{name}.json"] = folder / f"{name}.json"
        paths[f"{name}.json"].write_bytes(encode(cameras_of_two_videos(turn)))
    # Its format states no unit.
    paths["third.toml"] = folder / "third.toml"
    paths["third.toml"].write_bytes(encode_toml(cameras_of_two_videos(0.7)))
    paths["refused.toml"] = folder / "refused.toml"
    paths["refused.toml"].write_text("no calibration")
    (folder / "keypoints").mkdir(exist_ok=True)
    keypoint_capture(folder / "keypoints")
    for _, (name, content) in archives(folder / "keypoints"):
        paths[name] = folder / name
        paths[name].write_bytes(content)
    paths["keypoints.json"] = folder / "keypoints.json"
    paths["keypoints.json"].write_bytes((folder / "keypoints" / "calibration.json").read_bytes())
    return paths


@pytest.fixture(scope="module")
def stored(served: Served, files: dict[str, Path]) -> dict[str, str]:
    """Names by id of stored calibrations: two of the videos, one of the keypoints."""
    names = {}
    for file, name in (("first.json", "Rig of March"), ("second.json", "Rig of May"), ("keypoints.json", "Room")):
        spec = ("spec", (None, json.dumps({"method": "file", "name": name}).encode(), "application/json"))
        body: list[tuple[str, Any]] = [spec, ("calibration", (file, files[file].read_bytes()))]
        names[served.client.post("/v1/calibrations", files=body).raise_for_status().json()["id"]] = name
    return names


def actions_of(name: str, files: dict[str, Path]) -> tuple[list[Action], str]:
    """Actions in the form, and the calibration that is meant after all of them."""
    videos = [files["left.mp4"], files["right.mp4"]]
    zips = [path for name, path in sorted(files.items()) if name.endswith(".zip")]

    def unit(run: Run) -> None:
        choice = run.page.get_by_label("Unit of length")
        details = run.page.locator("details", has=choice)
        if details.get_attribute("open") is None:
            details.locator("summary").click()
        choice.select_option("cm")

    def reload(run: Run) -> None:
        # The draft is stored with its calibration, if one was chosen and is not kept back.
        run.wait(
            lambda: (
                not run.is_as_meant
                or run.page.evaluate(STORED)
                or (run.held and job_kind(run.held.request).startswith("GET /v1/calibrations"))
            )
        )
        run.page.reload()

    def exchange(run: Run) -> None:
        if run.page.get_by_label("Camera of cam_00.zip").count():
            run.page.get_by_label("Camera of cam_00.zip").select_option("cam_01")
            run.page.get_by_label("Camera of cam_01.zip").select_option("cam_00")

    def sample(run: Run) -> None:
        run.page.get_by_role("button", name="Try the sample capture").click()

    march, may = (lambda run: run.choose_stored("Rig of March")), (lambda run: run.choose_stored("Rig of May"))
    everything: dict[str, tuple[list[Action], str]] = {
        "a file in place of a stored one": ([march, lambda run: run.choose(*videos, files["third.json"])], "third"),
        "another stored one": ([lambda run: run.choose(*videos), march, may], "Rig of May"),
        "a refused file": ([march, lambda run: run.choose(*videos), lambda run: run.choose(files["refused.toml"])], ""),
        "another unit": ([lambda run: run.choose(*videos), lambda run: run.choose(files["third.toml"]), unit], "third"),
        "keypoints": (
            [
                lambda run: run.choose_stored("Room"),
                lambda run: run.choose(*zips),
                lambda run: run.page.get_by_label("Frame rate of keypoints").fill("50"),
                exchange,
            ],
            "Room",
        ),
        "the sample": ([march, sample], "Calib.qca"),
        "a draft after a reload": ([march, reload, lambda run: run.choose(*videos), may], "Rig of May"),
    }
    return everything[name]


NAMES = (
    *("a file in place of a stored one", "another stored one", "a refused file", "another unit"),
    *("keypoints", "the sample", "a draft after a reload"),
)


# Every seventh request is kept back: the six other sequences of actions, which make most of the others too, have those.
@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usefixtures("stored")
def test_sent_choices_equal_shown_choices(
    served: Served, files: dict[str, Path], sample: Sample, name: str, every: int
) -> None:
    """Send is pressed while requests that the form makes are kept back: at once, and after all other actions."""
    actions, meant = actions_of(name, files)
    num_bytes = {path.name: path.stat().st_size for path in [*files.values(), *sample.videos.values()]}
    with opened(f"{served.client.base_url}#/new", allowed=ALLOWED) as page:
        run = used(page, actions, None, SESSIONS, is_pressed_at_once=False)
        assert run.is_sent() == (meant != "")
        assert "GET /v1/options" in {kind for kind, _ in run.seen}
        pending = [kept for kept in run.seen if kept[0] not in OF_FRAME | {SESSIONS, JOBS} and is_first_of_many(kept)]
        for kept in pending[NAMES.index(name) % every :: every]:
            run = used(page, actions, kept, SESSIONS, is_pressed_at_once=False)
            assert_sent_as_shown(served, run, num_bytes, meant if run.is_as_meant else None)
            if run.is_held_early:  # else at once is after all actions
                run = used(page, actions, kept, SESSIONS, is_pressed_at_once=True)
                assert_sent_as_shown(served, run, num_bytes, None)


@pytest.mark.parametrize("is_busy", [False, True])
@pytest.mark.usefixtures("stored")
def test_second_press_sends_nothing_twice(served: Served, files: dict[str, Path], is_busy: bool) -> None:
    """Send is pressed again while the files are checked; the job has the choices that the page shows."""
    actions, meant = actions_of("another stored one", files)
    num_bytes = {path.name: path.stat().st_size for path in files.values()}
    unreal: Action = lambda run: run.page.get_by_role("radio", name="Unreal Engine").check()  # noqa: E731
    with opened(f"{served.client.base_url}#/new", allowed=ALLOWED) as page:
        run = used(page, [*actions, unreal], (SESSIONS, 1), JOBS, is_pressed_at_once=False, is_busy=is_busy)
        assert [len(run.bodies[kind]) for kind in (SESSIONS, JOBS)] == [1, 1]
        assert run.bodies[JOBS][0]["preset"] == "unreal"
        assert_shown(served, run, num_bytes, meant)


def is_first_of_many(kept: tuple[str, int]) -> bool:
    """Return whether a request is the first of its kind, of kinds that are many and alike."""
    return kept[1] == 1 or not kept[0].startswith(("PATCH", "POST /v1/uploads", "HEAD", "GET /v1/sample/"))


def used(
    page: Page,
    actions: list[Action],
    kept: tuple[str, int] | None,
    last: str,
    *,
    is_pressed_at_once: bool,
    is_busy: bool = False,
) -> Run:
    """Use the form and press Send, again while the request is kept back; let it go, and wait for what comes of it."""
    run = Run(page, kept, last, is_busy)
    for action in actions:
        run.is_held_early |= run.was_held
        action(run)
        page.wait_for_timeout(50)
        if is_pressed_at_once and run.held and not run.is_pressed:
            run.press()
    if kept is None:
        page.wait_for_timeout(500)
    if not run.is_pressed:
        run.wait(lambda: run.held or page.get_by_text(re.compile("Loading the|Checking the calibration")).count() == 0)
        run.press()
    run.wait(lambda: run.held or run.is_sent() or run.is_refused())
    if run.held:
        run.press()
        page.wait_for_timeout(100)
    run.release()
    run.wait(lambda: run.is_sent() or run.is_refused())
    page.wait_for_timeout(100)
    return run


def assert_sent_as_shown(served: Served, run: Run, num_bytes: dict[str, int], meant: str | None) -> None:
    """Compare what was sent, if anything was, once the request that was kept back has its answer."""
    assert run.was_held, (run.kept, run.refusals())
    assert len(run.bodies[SESSIONS]) <= 1, run.kept
    if run.is_sent():
        assert_shown(served, run, num_bytes, meant)


def assert_shown(served: Served, run: Run, num_bytes: dict[str, int], meant: str | None) -> None:
    """Compare the requests with the page, which is locked since they were sent."""
    session, shown, at = run.bodies[SESSIONS][0], run.page.evaluate(SHOWN), run.kept
    calibration = served.client.get(f"/v1/calibrations/{session['calibration_id']}").raise_for_status().json()
    assert calibration["name"] == shown["calibration"], at
    assert meant in {None, calibration["name"]}, at
    manifest = session["manifest"]
    assert manifest["name"] == shown["name"] or not shown["name"], at
    assert (manifest.get("clock"), manifest.get("frame_rate_hz")) == (shown["clock"], shown["rate_hz"]), at
    of_videos = [one for one in shown["rows"] if not one["file"].endswith(".zip")]
    assert [(one["name"], one["file"], one["offset_s"]) for one in manifest["cameras"]] == [
        (one["camera"], one["file"], one["offset_s"]) for one in of_videos
    ], at
    # A zip of keypoints is sent under the name of its camera.
    names = [one["file"] if one in of_videos else f"{one['camera']}.zip" for one in shown["rows"]]
    if not run.bodies[JOBS]:  # the uploads are there until the session is made
        uploads = dict(upload_of(served, each) for each in session["videos"] + session["keypoints"])
        expected = [num_bytes[one["file"]] for one in shown["rows"]]
        assert uploads == dict(zip(names, expected, strict=True)), at
    job = (run.bodies[JOBS] or [{"sync": manifest.get("sync", "declared")}])[0]
    assert job["sync"] == manifest.get("sync", "declared"), at
    for choice, value in job.items():
        assert shown["choices"].get(choice, value) == value, at


def upload_of(served: Served, upload_id: str) -> tuple[str, int]:
    """Name and size of an upload."""
    head = served.client.head(f"/v1/uploads/{upload_id}", headers={"Tus-Resumable": "1.0.0"}).raise_for_status()
    metadata = dict(pair.split(" ") for pair in head.headers["Upload-Metadata"].split(","))
    return base64.b64decode(metadata["filename"]).decode(), int(head.headers["Upload-Length"])
