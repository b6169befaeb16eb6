"""Outputs of a live capture on the page: a test pattern reaches a receiver, and the page tells the state of each."""

import socket
from collections.abc import Iterator

import pytest
from playwright.sync_api import ViewportSize, expect

from tests.e2e.browsing import axe_findings, opened
from tests.e2e.serving import Served, serving
from tests.e2e.test_live_page import num_bright
from tests.ports import free_port

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("page")]
NARROW: ViewportSize = {"width": 390, "height": 844}
STARTED_MS = 180_000


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("data")) as served:
        yield served


def test_test_pattern_reaches_receiver_and_states_are_told(service: Served) -> None:
    port, closed_port = free_port(), free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", port))
        receiver.settimeout(60)
        with opened(f"{service.client.base_url}#/live", NARROW) as page:
            for number, (protocol, port_number) in enumerate((("VMC", port), ("OSC", closed_port)), 1):
                page.get_by_role("button", name="Add an output").click()
                row = page.get_by_role("group", name=f"Output {number}")
                row.get_by_label("Protocol").select_option(protocol)
                expect(row.get_by_label("Host")).to_have_value("127.0.0.1")
                row.get_by_label("Port").fill(str(port_number))
            assert axe_findings(page) == []
            page.get_by_role("button", name="Send a test pattern").click()
            expect(page.get_by_role("row", name=f"vmc://127.0.0.1:{port} sends")).to_be_visible(timeout=STARTED_MS)
            expect(page.get_by_role("row", name=f"osc://127.0.0.1:{closed_port} no receiver answers")).to_be_visible()
            assert b"/VMC/Ext/Bone/Pos" in receiver.recv(65_536)
            stage = page.locator(".live-stage")
            expect(stage).to_have_attribute("data-people", "1")
            assert num_bright(stage.screenshot()) > 500
            assert axe_findings(page) == []
            assert page.evaluate("document.documentElement.scrollWidth") <= 390
            page.get_by_role("button", name="End now").click()
            expect(page.get_by_text("The capture is over:")).to_be_visible()


def test_wrong_output_is_told(service: Served) -> None:
    with opened(f"{service.client.base_url}#/live") as page:
        page.get_by_role("button", name="Add an output").click()
        page.get_by_role("group", name="Output 1").get_by_label("Host").fill("no such host.invalid")
        page.get_by_role("button", name="Send a test pattern").click()
        alert = page.get_by_role("alert")
        expect(alert).to_contain_text("The host 'no such host.invalid' is not known.", timeout=STARTED_MS)
        page.get_by_role("button", name="Remove output 1").click()
        expect(page.get_by_role("button", name="Send a test pattern")).to_be_hidden()
