import re

import pytest

from tests.api.conftest import Live


def test_page_and_all_that_it_refers_to(live: Live) -> None:
    answer = live.client.get("/")
    assert answer.headers["content-type"].startswith("text/html")
    references = set(re.findall(r'(?:src|href)="([^"]+)"', answer.text))
    assert references == {"/portal/page.css", "/portal/page.js", "/portal/icon.svg", "/openapi.json"}
    for reference in references:
        assert live.client.get(reference).status_code == 200


def test_types(live: Live) -> None:
    types = {
        name: live.client.get(f"/portal/{name}").headers["content-type"] for name in ("page.js", "page.css", "icon.svg")
    }
    assert types["page.js"].startswith("text/javascript")
    assert types["page.css"].startswith("text/css")
    assert types["icon.svg"] == "image/svg+xml"


@pytest.mark.parametrize("path", ["/", "/portal/page.js", "/portal/page.css"])
def test_nothing_comes_from_elsewhere_and_no_text_is_markup(live: Live, path: str) -> None:
    text = live.client.get(path).text
    assert not re.findall(r"https?://", text)
    assert not re.findall(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b", text)
    assert not re.findall(r"<style|style=|\son\w+=|javascript:", text)
