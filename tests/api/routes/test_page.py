"""Page and Swagger UI: their files, types, polling and the form of choices."""

import re
from urllib.parse import urlsplit

import pytest

from tests.api.conftest import Live
from tests.e2e.test_page import opened


def test_page_and_all_that_it_refers_to(live: Live) -> None:
    answer = live.client.get("/")
    assert answer.headers["content-type"].startswith("text/html")
    references = set(re.findall(r'(?:src|href)="([^"]+)"', answer.text))
    assert references == {"/portal/page.css", "/portal/page.js", "/portal/icon.svg", "/docs", "/openapi.json"}
    for reference in references:
        assert live.client.get(reference).status_code == 200


def test_types(live: Live) -> None:
    types = {
        name: live.client.get(f"/portal/{name}").headers["content-type"] for name in ("page.js", "page.css", "icon.svg")
    }
    assert types["page.js"].startswith("text/javascript")
    assert types["page.css"].startswith("text/css")
    assert types["icon.svg"] == "image/svg+xml"


@pytest.mark.parametrize("path", ["/", "/docs", "/portal/docs.js", "/portal/page.js", "/portal/page.css"])
def test_nothing_comes_from_elsewhere_and_no_text_is_markup(live: Live, path: str) -> None:
    text = live.client.get(path).text
    assert not re.findall(r"https?://", text)
    assert not re.findall(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b", text)
    assert not re.findall(r"<style|style=|\son\w+=|javascript:", text)


def test_the_contract_s_page_and_all_that_it_refers_to(live: Live) -> None:
    answer = live.client.get("/docs")
    references = set(re.findall(r'(?:src|href)="([^"]+)"', answer.text))
    assert references == {
        "/portal/swagger-ui.css", "/portal/swagger-ui-bundle.js", "/portal/docs.js", "/portal/icon.svg",
        "/openapi.json",
    }  # fmt: skip
    for reference in references:
        assert live.client.get(reference).status_code == 200
    policy = answer.headers["content-security-policy"]
    assert policy == live.client.get("/").headers["content-security-policy"].replace(
        "img-src 'self'", "img-src 'self' data:"
    )


def test_while_a_job_is_watched_nothing_else_is_asked_each_second(live: Live) -> None:
    live.job_id()  # without a worker it stays queued
    asked: list[str] = []
    with opened(str(live.client.base_url)) as page:
        page.wait_for_load_state("networkidle")
        page.clock.install()
        page.on("request", lambda request: asked.append(urlsplit(request.url).path))
        with page.expect_response("**/v1/options"):
            page.reload()
        for _ in range(8):
            with page.expect_response("**/v1/jobs?*"):
                page.clock.run_for(1000)
        assert asked.count("/v1/options") == 1
        with page.expect_response("**/v1/options"):
            page.clock.run_for(31_000)


def test_the_form_has_a_field_for_every_choice(live: Live) -> None:
    choices = {one["name"]: one for one in live.client.get("/v1/options").json()["choices"]}
    with opened(str(live.client.base_url)) as page:
        page.get_by_text("Options", exact=True).click()
        names = page.locator("#choices [name]").evaluate_all("all => all.map(one => one.name)")
        assert list(dict.fromkeys(names)) == list(choices)
        assert page.get_by_label(choices["smoothing"]["label"]).input_value() == "fit"
        cutoff = page.get_by_label(choices["cutoff_hz"]["label"])
        assert (cutoff.input_value(), cutoff.get_attribute("max")) == ("6", "1000")
        people = page.get_by_label(choices["people"]["label"])
        assert (people.input_value(), people.get_attribute("placeholder")) == ("", "everybody")
        exports = page.get_by_role("group", name=choices["exports"]["label"]).get_by_role("checkbox")
        assert exports.evaluate_all("all => all.map(one => one.checked)") == [True, False, False, False, False]
        assert page.get_by_role("group", name=choices["frame_range"]["label"]).get_by_role("spinbutton").count() == 2
