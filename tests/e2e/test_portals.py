"""The client for npm against a service, in Node.js and in Chromium, and the portals of `docs/reference/clients.md`."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest
from playwright.sync_api import Page, expect

from pipeline.core.runtime.packages.samples import Sample
from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.e2e.browsing import opened
from tests.e2e.served_captures import ServedCapture, served_capture
from tests.e2e.serving import file_server
from tests.ports import free_port
from tests.waiting import wait_for

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "clients" / "typescript"
DOCUMENT = ROOT / "docs/reference/clients.md"
SPEC = 'exports"?: \\["bvh"\\]'
NODE = str(Path(sys.executable).with_name("node"))


def program(name: str, *changes: tuple[str, str]) -> str:
    """Program of the page, with changes: patterns that occur once, and what replaces them."""
    (code,) = re.findall(rf'^```\w+ title="{name}"\n(.*?)^```$', DOCUMENT.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    for pattern, replacement in changes:
        code, count = re.subn(pattern, replacement, code)
        assert count == 1, pattern
    return str(code)


@dataclass(frozen=True, slots=True)
class Portal:
    """Folder that a web server serves at an address of its own, and a service that its pages may call."""

    url: str
    folder: Path
    capture: ServedCapture

    @property
    def files(self) -> tuple[list[Path], Path]:
        return sorted(self.capture.take.glob("*.mp4")), self.capture.take / "calibration.toml"


@pytest.fixture(scope="module")
def portal(sample: Sample, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Portal]:
    folder = tmp_path_factory.mktemp("portal")
    (folder / "pages").mkdir()
    with (
        file_server(folder / "pages") as url,
        served_capture(sample, folder, MULTICAP_ALLOWED_ORIGINS=json.dumps([url])) as capture,
    ):
        yield Portal(url, folder / "pages", capture)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Project in which the package of `make clients` is installed."""
    if not (PACKAGE / "dist" / ".built").is_file():
        pytest.skip("the client for npm is not built (`make clients` does it)")
    folder = tmp_path_factory.mktemp("project")
    modules = folder / "node_modules"
    modules.mkdir()
    for path in (PACKAGE / "node_modules").iterdir():
        (modules / path.name).symlink_to(path)
    version = json.loads((PACKAGE / "package.json").read_text("utf-8"))["version"]
    shutil.unpack_archive(ROOT / "build" / f"multicap-client-{version}.tgz", folder)
    (folder / "package").rename(modules / "multicap-client")
    (folder / "package.json").write_text('{"private": true, "type": "module"}')
    return folder


def require_results(portal: Portal, job_id: str, contents: dict[str, bytes]) -> None:
    """Check that the files of a job are whole, and that it was the short job."""
    job = portal.capture.served.job(job_id)
    assert (job["state"], job["spec"]["frame_range"]) == ("succeeded", [0, 20])
    assert {"person-1.bvh", "skeletons.json"} <= contents.keys()
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
    assert digests == portal.capture.served.downloads(job_id)


def newest_job(portal: Portal) -> str:
    jobs = portal.capture.served.client.get("/v1/jobs", params={"limit": 1}).raise_for_status().json()["jobs"]
    return str(jobs[0]["id"])


@pytest.fixture(scope="module")
def node_run(portal: Portal, package: Path) -> dict[str, Any]:
    """Output of `node_client.ts`, whose types are checked first."""
    shutil.copy(Path(__file__).with_name("node_client.ts"), package)
    compiler = [NODE, "node_modules/typescript/bin/tsc", "node_client.ts"]
    options = ["--noEmit", "--strict", "--module", "nodenext", "--target", "esnext", "--types", "node"]
    subprocess.run([*compiler, *options], cwd=package, check=True)
    command = [NODE, "node_client.ts", portal.capture.url, portal.capture.key, str(portal.capture.take)]
    done = subprocess.run(command, cwd=package, stdout=subprocess.PIPE, text=True, timeout=600, check=True)
    return dict(json.loads(done.stdout))


def test_node_client_sends_and_downloads(portal: Portal, package: Path, node_run: dict[str, Any]) -> None:
    job = node_run["last"]
    contents = {result: (package / result).read_bytes() for result in portal.capture.served.downloads(job["id"])}
    require_results(portal, job["id"], contents)
    videos, calibration = portal.files
    total = sum(path.stat().st_size for path in (*videos, calibration))
    assert node_run["progress"][-1] == {"sent": total, "total": total}
    assert node_run["newest"] == job["id"]


def test_node_client_follows_by_events(node_run: dict[str, Any]) -> None:
    shares = [update["progress"] for update in node_run["updates"]]
    assert shares == sorted(shares)
    assert [shares[-1], node_run["updates"][-1]["state"]] == [1.0, "succeeded"]
    assert len({update["state"] for update in node_run["updates"]}) >= 2


def test_node_client_gets_all_problems(node_run: dict[str, Any]) -> None:
    refused = node_run["refused"]
    assert refused["status"] == 422
    assert {error["file"] for error in refused["errors"]} >= {"left.mp4", "right.mp4"}
    assert all(f"{name}: " in refused["message"] for name in ("left.mp4", "right.mp4"))
    assert re.fullmatch(r"[0-9a-f-]{36}", refused["requestId"])
    bad_spec = node_run["badSpec"]
    assert bad_spec["status"] == 422
    assert {error["code"] for error in bad_spec["errors"]} == {"invalid_value", "value_not_allowed"}


def test_node_client_with_wrong_key_is_refused(node_run: dict[str, Any]) -> None:
    assert (node_run["wrongKey"]["status"], node_run["wrongKey"]["code"]) == (401, "key_required")


def test_canceled_job_ends_following(node_run: dict[str, Any]) -> None:
    assert node_run["canceled"]["message"] == "The job was canceled."


@pytest.fixture
def page(portal: Portal, package: Path) -> Iterator[Page]:
    """Portal of the page in Chromium; a test may choose the frames by `frames_`."""
    address = ("https://multicap\\.example", portal.capture.url)
    html = program("portal.html", address, (SPEC, 'exports: ["bvh"], frame_range: globalThis.frames_ ?? null'))
    (portal.folder / "portal.html").write_text(html, "utf-8")
    shutil.copy(package / "node_modules/multicap-client/dist/page.js", portal.folder)
    allowed = ("401 (Unauthorized)", "422 (Unprocessable", "favicon.ico", "404 (File not found)")
    with opened(f"{portal.url}/portal.html", allowed=allowed) as page:
        yield page


def send(page: Page, key: str, videos: list[Path], calibration: Path) -> None:
    page.get_by_label("Key").fill(key)
    page.get_by_label("Videos").set_input_files(videos)
    page.get_by_label("Calibration").set_input_files(calibration)
    page.get_by_role("button", name="Send").click()


def test_portal_in_browser_sends_and_downloads(page: Page, portal: Portal) -> None:
    page.evaluate("globalThis.frames_ = [0, 20]")
    send(page, portal.capture.key, *portal.files)
    expect(page.get_by_role("status")).to_have_text(re.compile("^(Sent|queued|running): "))
    expect(page.get_by_role("link", name="skeletons.json")).to_be_visible(timeout=300_000)
    assert page.get_by_role("status").inner_text() == "succeeded: 100 %"
    job_id = newest_job(portal)
    wait_for(lambda: page.get_by_role("link").count() == len(portal.capture.served.downloads(job_id)))
    contents = {}
    for name in page.get_by_role("link").all_inner_texts():
        with page.expect_download() as download:
            page.get_by_role("link", name=name, exact=True).click()
        contents[name] = download.value.path().read_bytes()
    require_results(portal, job_id, contents)


def test_portal_in_browser_cancels(page: Page, portal: Portal) -> None:
    send(page, portal.capture.key, *portal.files)
    expect(page.get_by_role("status")).to_have_text(re.compile("^(queued|running): "), timeout=120_000)
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("status")).to_have_text("The job was canceled.", timeout=120_000)


def test_portal_in_browser_refuses_wrong_key(page: Page, portal: Portal) -> None:
    send(page, "mc_wrong", *portal.files)
    expect(page.get_by_role("status")).to_contain_text("key")


def test_portal_in_browser_shows_all_problems(page: Page, portal: Portal, tmp_path: Path) -> None:
    videos = [tmp_path / name for name in ("left.mp4", "right.mp4")]
    for path in videos:
        path.write_bytes(b"no video")
    send(page, portal.capture.key, videos, portal.files[1])
    for path in videos:
        expect(page.get_by_role("status")).to_contain_text(f"{path.name}: ", timeout=120_000)


@pytest.fixture
def python_portal(portal: Portal, tmp_path: Path) -> Iterator[httpx2.Client]:
    """Portal in Python as a process."""
    port = free_port()
    code = program("portal.py", ("port=8080", f"port={port}"), (SPEC, 'exports": ["bvh"], "frame_range": [0, 20]'))
    (tmp_path / "portal.py").write_text(code, "utf-8")
    command = tied_to_parent([sys.executable, "portal.py", portal.capture.url, portal.capture.key])
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with (
        subprocess.Popen(command, cwd=tmp_path, env=environment) as process,
        httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=180, trust_env=False) as client,
    ):
        try:
            wait_for(lambda: answers(client), timeout_s=60)
            yield client
        finally:
            process.terminate()


def answers(client: httpx2.Client) -> bool:
    try:
        return "<form" in client.get("/").text
    except httpx2.TransportError:
        return False


def form(videos: list[tuple[str, bytes]], calibration: Path) -> list[tuple[str, tuple[str, bytes]]]:
    parts = [("videos", video) for video in videos]
    return [*parts, ("calibration", (calibration.name, calibration.read_bytes()))]


def test_portal_in_python_sends_and_downloads(python_portal: httpx2.Client, portal: Portal) -> None:
    videos, calibration = portal.files
    files = form([(path.name, path.read_bytes()) for path in videos], calibration)
    sent = python_portal.post("/jobs", files=files)
    assert sent.status_code == 303, sent.text
    shown: list[str] = []

    def has_ended() -> bool:
        shown.append(python_portal.get(sent.headers["location"]).raise_for_status().text)
        return "href=" in shown[-1]

    wait_for(has_ended, timeout_s=300)
    assert re.search(r"(queued|running): \d+%", shown[0])
    paths = re.findall(r"href=(\S+) download", shown[-1])
    contents = {path.rpartition("/")[2]: python_portal.get(path).raise_for_status().content for path in paths}
    require_results(portal, sent.headers["location"].rpartition("/")[2], contents)


def test_portal_in_python_shows_all_problems(python_portal: httpx2.Client, portal: Portal) -> None:
    files = form([("left.mp4", b"no video"), ("right.mp4", b"no video")], portal.files[1])
    refused = python_portal.post("/jobs", files=files)
    assert refused.status_code == 422
    assert "left.mp4: " in refused.text
    assert "right.mp4: " in refused.text
