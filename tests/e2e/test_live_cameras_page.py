"""Live captures of cameras from the page: streams on loopback, a real browser, people in 3D."""

import contextlib
import itertools
import json
import re
import socket
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from io import BytesIO
from pathlib import Path

import av
import pytest
from playwright.sync_api import Page, ViewportSize, expect

from pipeline.calibration.write import encode
from pipeline.core.runtime.child_processes import python_command
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.serving import Served, serving
from tests.e2e.simulated_detection import filmed_room, pictures
from tests.e2e.test_live_page import num_bright
from tests.pipeline.run.live.cameras.servers import LoopbackServer
from tests.ports import free_port

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("page")]
NARROW: ViewportSize = {"width": 390, "height": 844}
RATE_HZ, GROUP = 15, 15
FIRST_S = time.monotonic()
STARTED_MS = 180_000


def encoded(images: list[av.VideoFrame]) -> list[bytes]:
    """Pictures in H.264, forwards and backwards; each one of ``GROUP`` is whole by itself."""
    encoder = av.CodecContext.create("libx264", "w")
    assert isinstance(encoder, av.VideoCodecContext)
    (encoder.width, encoder.height), encoder.pix_fmt = (images[0].width, images[0].height), "yuv420p"
    encoder.time_base = Fraction(1, RATE_HZ)
    encoder.options = {"tune": "zerolatency", "x264-params": f"keyint={GROUP}:scenecut=0"}
    packets = []
    for number, image in enumerate(images + images[-2:0:-1]):
        shown = image.reformat(format="yuv420p")
        shown.pts, shown.time_base = number, Fraction(1, RATE_HZ)
        packets += encoder.encode(shown)
    return [bytes(packet) for packet in packets]


def filming_camera(pictures: list[bytes]) -> Callable[[socket.socket], None]:
    """Camera that sends its pictures over and over as MPEG-TS by HTTP, in step with all others."""

    def answer(connection: socket.socket) -> None:
        connection.recv(65_536)
        connection.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: video/mp2t\r\n\r\n")
        with av.open(written := BytesIO(), "w", format="mpegts") as stream:
            target = stream.add_stream("libx264", RATE_HZ)
            target.width, target.height, target.pix_fmt = 64, 64, "yuv420p"  # the pictures have their own sizes
            soon = itertools.count(int((time.monotonic() - FIRST_S) * RATE_HZ) + 1)
            for number in itertools.dropwhile(lambda number: number % len(pictures) % GROUP, soon):
                packet = av.Packet(pictures[number % len(pictures)])
                packet.stream, packet.time_base = target, Fraction(1, RATE_HZ)
                packet.pts = packet.dts = number
                packet.is_keyframe = number % len(pictures) % GROUP == 0
                stream.mux(packet)
                time.sleep(max(0.0, FIRST_S + number / RATE_HZ - time.monotonic()))
                connection.sendall(written.getvalue())
                written.seek(0)
                written.truncate()

    return answer


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Service whose networks find the joints of a simulated scene."""
    command = json.dumps(python_command("-m", "tests.e2e.simulated_detection"))
    with serving(tmp_path_factory.mktemp("data"), MULTICAP_LIVE_CAMERAS_COMMAND=command) as served:
        yield served


@pytest.fixture
def streams() -> Iterator[dict[str, LoopbackServer]]:
    """Servers of the scene's cameras by their names."""
    with contextlib.ExitStack() as opened_servers:
        yield {
            camera.name: opened_servers.enter_context(LoopbackServer(filming_camera(encoded(pictures(number)))))
            for number, camera in enumerate(filmed_room().cameras)
        }


def choose_calibration(page: Page, folder: Path) -> None:
    path = folder / "rig.json"
    path.write_bytes(encode(filmed_room().cameras))
    page.locator("input[type=file][accept*=toml]").last.set_input_files(path)
    expect(page.get_by_role("combobox", name="Address of cam_00")).to_be_visible(timeout=STARTED_MS)


def test_streams_by_address_become_people_in_3d(
    service: Served, streams: dict[str, LoopbackServer], tmp_path: Path
) -> None:
    with opened(f"{service.client.base_url}#/live", NARROW) as page:
        page.get_by_role("button", name="Start the capture").click()
        expect(page.get_by_role("alert")).to_contain_text("Type the addresses of two cameras or more.")
        expect(page.get_by_role("alert")).to_contain_text("Choose the calibration")
        choose_calibration(page, tmp_path)
        for name, server in streams.items():
            page.get_by_role("combobox", name=f"Address of {name}").fill(f"http://127.0.0.1:{server.port}/video.ts")
        page.get_by_label("Keep as a capture").check()
        assert axe_findings(page) == []
        page.get_by_role("button", name="Start the capture").press("Enter")
        expect(page.get_by_text(re.compile("3, [1-3] with a skeleton"))).to_be_visible(timeout=STARTED_MS)
        stage = page.locator(".live-stage")
        expect(stage).to_have_attribute("data-people", "3")
        expect(page.get_by_role("row", name=re.compile("cam_00 open"))).to_be_visible()
        assert num_bright(stage.screenshot()) > 500
        assert axe_findings(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        streams["cam_01"].close()
        expect(page.get_by_role("log")).to_contain_text("cam_01 is lost")
        page.get_by_role("button", name="End now").press("Enter")
        expect(page.get_by_text(re.compile("frames of .* are kept"))).to_be_visible(timeout=STARTED_MS)


def test_wrong_cameras_all_problems_at_once(service: Served, tmp_path: Path) -> None:
    with opened(f"{service.client.base_url}#/live") as page:
        choose_calibration(page, tmp_path)
        page.get_by_role("combobox", name="Address of cam_00").fill("ftp://127.0.0.1/x")
        page.get_by_role("combobox", name="Address of cam_01").fill("/etc/passwd")
        page.get_by_role("button", name="Start the capture").click()
        alert = page.get_by_role("alert")
        expect(alert).to_contain_text("cam_00: Streams of ftp:// are not supported.")
        expect(alert).to_contain_text("cam_01: The service's machine has no such camera that may be opened.")
        port = free_port()
        page.get_by_role("combobox", name="Address of cam_00").fill(f"rtsp://127.0.0.1:{port}/")
        page.get_by_role("combobox", name="Address of cam_01").fill(f"http://127.0.0.1:{port}/")
        page.get_by_role("button", name="Start the capture").click()
        expect(alert).to_contain_text("cam_00: The stream can't be opened: Connection refused.", timeout=STARTED_MS)
        expect(alert).to_contain_text("cam_01: The stream can't be opened: Connection refused.")
