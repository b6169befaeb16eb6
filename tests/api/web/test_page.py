"""Page and Swagger UI: their files, types, polling and the form of choices."""

import posixpath
import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import expect

from pipeline.core.runtime.packages import samples
from tests.api.conftest import Live
from tests.e2e.browsing import opened

PORTAL = Path(__file__).parents[3] / "api" / "portal"


@pytest.mark.parametrize(
    ("path", "some"),
    [
        ("/", {"/portal/main.js", "/portal/shared/base.css", "/docs", "/openapi.json"}),
        ("/record", {"/portal/record/phone/start.js", "/portal/shared/base.css"}),
        ("/portal/record/board.html", {"/portal/record/board/board.js"}),
    ],
)
def test_page_and_all_that_it_refers_to(live: Live, path: str, some: set[str]) -> None:
    answer = live.client.get(path)
    assert answer.headers["content-type"].startswith("text/html")
    references = {one for one in re.findall(r'(?:src|href)="([^"]+)"', answer.text) if not one.startswith("#")}
    assert some <= references
    for reference in references - {"/help/"}:  # `make docs` builds it
        assert live.client.get(reference).status_code == 200, reference


def modules() -> list[str]:
    """Modules and style sheets of the page, without libraries."""
    paths = [path.relative_to(PORTAL) for ending in ("js", "css", "html") for path in PORTAL.rglob(f"*.{ending}")]
    return [path.as_posix() for path in paths if path.parts[0] not in {"help", "node_modules", "vendor"}]


def test_modules_refer_to_modules_that_exist(live: Live) -> None:
    for name in modules():
        for one in re.findall(r'(?:from|import\()\s*"(\.[^"]+)"', live.client.get(f"/portal/{name}").text):
            path = (PORTAL / name).parent / one
            assert path.is_file(), f"{name} imports {one}"
            assert live.client.get(f"/portal/{path.resolve().relative_to(PORTAL)}").status_code == 200


def test_types(live: Live) -> None:
    names = ("main.js", "shared/base.css", "icon.svg")
    types = {name: live.client.get(f"/portal/{name}").headers["content-type"] for name in names}
    assert types["main.js"].startswith("text/javascript")
    assert types["shared/base.css"].startswith("text/css")
    assert types["icon.svg"] == "image/svg+xml"


def test_only_files_for_browsers_are_served(live: Live) -> None:
    for name in (
        "package.json",
        "package-lock.json",
        "vendor.mjs",
        "node_modules/three/build/three.core.js",
        "../app.py",
    ):
        assert live.client.get(f"/portal/{name}").status_code == 404, name


def test_texts_are_sent_compressed_with_entity_tag_of_their_own(live: Live) -> None:
    path = "/portal/shared/base.css"
    plain = live.client.get(path, headers={"Accept-Encoding": "identity"})
    packed = live.client.get(path, headers={"Accept-Encoding": "br, gzip;q=0.5"})
    assert "content-encoding" not in plain.headers
    assert packed.headers["content-encoding"] == "gzip"
    assert packed.content == plain.content == (PORTAL / "shared/base.css").read_bytes()
    assert packed.num_bytes_downloaded < len(plain.content) / 2
    assert plain.headers["vary"].startswith("Accept-Encoding")
    assert packed.headers["vary"].startswith("Accept-Encoding")
    for answer, encoding in ((plain, "identity"), (packed, "gzip")):
        headers = {"Accept-Encoding": encoding, "If-None-Match": answer.headers["etag"]}
        assert live.client.get(path, headers=headers).status_code == 304


def test_nothing_comes_from_elsewhere_and_no_text_is_markup(live: Live) -> None:
    for path in ("/", "/docs", "/record", *(f"/portal/{name}" for name in modules())):
        text = live.client.get(path).raise_for_status().text
        assert not re.findall(r"https?://", text), path
        markup = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|unsafeHTML"
        assert not re.findall(markup, text), path
        assert not re.findall(r"<style|style=|\son\w+=|javascript:", text), path


def test_contract_s_page_and_all_that_it_refers_to(live: Live) -> None:
    answer = live.client.get("/docs")
    references = set(re.findall(r'(?:src|href)="([^"]+)"', answer.text))
    assert references == {
        "/portal/swagger-ui.css", "/portal/swagger-ui-bundle.js", "/portal/docs.js", "/portal/icon.svg",
        "/openapi.json",
    }  # fmt: skip
    for reference in references:
        assert live.client.get(reference).status_code == 200
    for path in ("/", "/docs", "/record"):
        parts = live.client.get(path).headers["content-security-policy"].split(";")
        policy = dict(part.strip().split(" ", 1) for part in parts)
        assert len(policy) == len(parts)
        assert policy["default-src"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"


@pytest.mark.slow
def test_while_jobs_are_watched_only_they_are_asked_for(live: Live) -> None:
    job_id = live.job_id()  # without a worker it stays queued
    asked: list[str] = []
    with opened(str(live.client.base_url)) as page:
        page.wait_for_load_state()
        expect(page.locator(".job .state")).to_have_text("Waiting")
        page.clock.install()
        page.on("request", lambda request: asked.append(urlsplit(request.url).path))
        # Its stream tells of it: the list is asked for seldom.
        with page.expect_response("**/v1/jobs?*"):
            page.clock.run_for(11_000)
        live.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        expect(page.locator(".job .state")).to_have_text("Canceled")
        assert set(asked) == {"/v1/jobs"}


# Notifications of the page as lists of their texts, and a page that is in the background.
BACKGROUND = """() => {
  globalThis.notices = [];
  globalThis.Notification = class extends Notification {
    constructor(title, options) { super(title, options); notices.push([title, options.body]); }
  };
  Object.defineProperty(document, "hidden", { get: () => true });
}"""


@pytest.mark.slow
def test_title_tells_share_and_end_is_notified(live: Live) -> None:
    job_id = live.job_id()
    with opened(f"{live.client.base_url}#/jobs/{job_id}") as page:
        page.context.grant_permissions(["notifications"])
        expect(page).to_have_title("untitled · Multicap")
        claim = live.services.store.leases.claim("test", 60.0)
        assert claim is not None
        leases = live.services.store.leases
        assert leases.heartbeat(claim.chunk_id, claim.lease_token, max(1, claim.unit_count // 2), 60.0)
        expect(page).to_have_title(re.compile(r"^\d+ % · untitled · Multicap$"))
        page.get_by_label("Notify me of ends").check()
        expect(page.get_by_label("Notify me of ends")).to_be_checked()
        page.evaluate(BACKGROUND)
        live.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        leases.release(claim.chunk_id, claim.lease_token)
        expect(page).to_have_title("untitled · Multicap")
        assert page.evaluate("notices") == [["untitled", "Canceled"]]


@pytest.mark.slow
def test_service_without_streams_is_polled(live: Live) -> None:
    job_id = live.job_id()
    with opened(str(live.client.base_url), allowed=("ERR_FAILED",)) as page:
        page.route("**/v1/jobs/*/events", lambda route: route.abort())
        page.reload()
        expect(page.locator(".job .state")).to_have_text("Waiting")
        live.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        expect(page.locator(".job .state")).to_have_text("Canceled")


def test_form_has_field_for_every_choice(live: Live) -> None:
    choices = {one["name"]: one for one in live.client.get("/v1/options").json()["choices"]}
    with opened(f"{live.client.base_url}#/new") as page:
        page.get_by_text("Customise", exact=True).click()
        fields = page.locator("[name^='send-']")
        names = {name.removeprefix("send-") for name in fields.evaluate_all("all => all.map(one => one.name)")}
        # The clocks are measured where the start of the videos stands: tests/e2e/test_words.py
        assert names == {*choices, "more-people", "purpose"} - {"sync"}
        group = page.locator("[data-group]").filter(has=page.get_by_label(choices["preset"]["label"], exact=True))
        assert group.get_attribute("data-group") == choices["preset"]["group"] == "purpose"
        assert page.get_by_label(choices["smoothing"]["label"], exact=True).input_value() == "fit"
        cutoff = page.get_by_label(choices["cutoff_hz"]["label"], exact=True)
        assert (cutoff.get_attribute("placeholder"), cutoff.get_attribute("max")) == ("6", "1000")
        people = page.get_by_role("group", name=choices["people"]["label"])
        expect(people.get_by_role("radio", name="Everyone")).to_be_checked()
        exports = page.get_by_role("group", name=choices["exports"]["label"]).get_by_role("checkbox")
        assert exports.evaluate_all("all => all.map(one => one.checked)") == [
            True,
            *[False] * (len(choices["exports"]["values"]) - 1),
        ]
        assert page.get_by_role("group", name=choices["frame_range"]["label"]).get_by_role("spinbutton").count() == 2


@pytest.mark.slow
def test_job_is_canceled_retried_and_deleted_by_keyboard(live: Live) -> None:
    live.job_id()  # without a worker it stays queued
    with opened(f"{live.client.base_url}#/captures") as page:
        page.get_by_role("button", name="Cancel untitled").press("Enter")
        row = page.locator(".job")
        expect(row.locator(".state")).to_have_text("Canceled")
        expect(row).to_be_focused()  # its button is gone, the place is kept
        page.get_by_role("button", name="Retry untitled").press("Enter")
        expect(row.locator(".state")).to_have_text("Waiting")
        expect(row).to_contain_text("attempt 2")
        expect(row).to_be_focused()
        page.get_by_role("button", name="Cancel untitled").press("Enter")
        page.get_by_role("button", name="Delete job of untitled").press("Enter")
        page.get_by_role("dialog").get_by_role("button", name="Delete the job").press("Enter")
        expect(page.get_by_text("No jobs yet.")).to_be_visible()
        expect(page.get_by_role("heading", name="Captures", level=1)).to_be_focused()


def test_without_sample_capture_page_says_how_to_install_it(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "locate", lambda: None)
    assert live.client.get("/v1/sample").json() == {
        "installed": False,
        "install": "Run: multicap samples install",
        "attribution": samples.ATTRIBUTION,
        "files": [],
    }
    assert live.client.get("/v1/sample/cam01.mp4").status_code == 404
    with opened(f"{live.client.base_url}#/new") as page:
        page.get_by_role("button", name="Try the sample capture").click()
        expect(page.get_by_role("alert")).to_contain_text("Run: multicap samples install")


def test_without_its_libraries_page_says_what_is_missing(live: Live) -> None:
    with opened(str(live.client.base_url), allowed=("404",)) as page:
        page.route("**/portal/vendor/**", lambda route: route.fulfill(status=404))
        page.reload()
        expect(page.get_by_role("heading", name="The libraries of this page are not installed")).to_be_visible()
        expect(page.get_by_role("main")).to_contain_text("make setup")


STATIC_IMPORT = re.compile(r'^(?:import|export)\b[^;(]*?"([^"]+\.js)"', re.MULTILINE)
STYLES = re.findall(r'stylesheet" href="/portal/([^"]+)"', (PORTAL / "index.html").read_text(encoding="utf-8"))


def imported(name: str) -> set[str]:
    """A module of the page and all modules that it needs before it runs."""
    reached, wanted = set[str](), {name}
    while wanted:
        reached |= wanted
        paths = [
            posixpath.join(posixpath.dirname(module), path)
            for module in wanted
            for path in STATIC_IMPORT.findall((PORTAL / module).read_text(encoding="utf-8"))
        ]
        wanted = {*map(posixpath.normpath, paths)} - reached
    return reached


def test_page_is_small(live: Live) -> None:
    paths = [path for path in PORTAL.rglob("*") if path.suffix in {".js", ".css", ".html", ".svg"}]
    names = [path.relative_to(PORTAL) for path in paths if not {"help", "node_modules"} & {*path.parts}]
    headers = {"Accept-Encoding": "gzip"}
    sizes = {
        name.as_posix(): live.client.get(f"/portal/{name.as_posix()}", headers=headers).num_bytes_downloaded
        for name in names
    }
    assert sizes["vendor/three/three.core.js"] > 100_000
    assert sum(sizes.values()) <= 1_000_000
    for view in re.findall(r'import\("./([^"]+/view\.js)"\)', (PORTAL / "app.js").read_text(encoding="utf-8")):
        first = {"index.html", *STYLES, *imported("main.js"), *imported("app.js"), *imported(view)}
        assert sum(sizes[name] for name in first) <= 147_000, view
