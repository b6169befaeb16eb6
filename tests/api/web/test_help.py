"""Site of the documentation: built strictly, whole without a network, and answered at /help."""

import re
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from playwright.sync_api import expect

from api.web.errors import ApiError
from api.web.help import FOLDER, HelpFiles, read_topics
from pipeline.core.options.config import CHOICES
from tests.api.conftest import Live
from tests.e2e.browsing import opened
from website.problems_page import SENTENCES

needs_site = pytest.mark.skipif(not (FOLDER / "topics.json").is_file(), reason="needs `make docs`")


def test_help_without_site_says_how_to_build_it(tmp_path: Path) -> None:
    with pytest.raises(ApiError) as refused:
        TestClient(HelpFiles(tmp_path / "missing")).get("/calibration")
    assert (refused.value.code, refused.value.hint) == ("not_found", "Run `make docs` in the checkout.")


@needs_site
def test_topic_leads_to_its_page(live: Live) -> None:
    answer = live.client.get("/help/calibration", follow_redirects=True)
    assert answer.url.path == "/help/guide/calibration.html"
    assert "<h1" in answer.text


@needs_site
def test_unknown_topic_is_refused(live: Live) -> None:
    assert live.client.get("/help/nothing").status_code == 404
    assert live.client.get("/help/../web/help.py").status_code == 404


@needs_site
def test_pages_load_nothing_from_elsewhere() -> None:
    for page in FOLDER.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|link|img|iframe)\b[^>]*(?:src|href)=\"?(https?:[^\s\">]+)", text)
        assert loaded == [], page
        assert "@import" not in text, page


@needs_site
def test_every_choice_and_code_has_its_place() -> None:
    options = (FOLDER / "reference/options.html").read_text(encoding="utf-8")
    assert [name for name in CHOICES if f'id="{name}"' not in options] == []
    problems = (FOLDER / "reference/problems.html").read_text(encoding="utf-8")
    assert [code for code in SENTENCES if f'id="{code}"' not in problems] == []


@needs_site
def test_search_finds_a_page_in_the_dark(live: Live) -> None:
    with opened(str(live.client.base_url)) as page:
        page.emulate_media(color_scheme="dark")
        page.goto("/help/")
        expect(page.locator("body")).to_have_attribute("data-md-color-scheme", "slate")
        page.get_by_placeholder("Search").fill("synchronization")
        expect(page.locator(".md-search-result__link", has_text="Synchronization").first).to_be_visible()


@needs_site
def test_every_topic_has_a_title_and_a_purpose() -> None:
    topics = read_topics()
    assert {"first-take", "calibration", "options", "security", "tracking", "limits"} <= topics.keys()
    assert [name for name, topic in topics.items() if not topic["title"] or not topic["about"]] == []
