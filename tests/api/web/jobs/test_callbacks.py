"""URLs for webhooks of a job; messages are tested in ``tests/worker/run/webhooks``."""

from collections.abc import Callable

import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from worker.store.model.rights import DEFAULT_TENANT

HOOK = "https://portal.example/hooks/multicap?x=1"


def test_job_states_its_callback(live: Live) -> None:
    live.services.store.webhook_secrets.rotate(DEFAULT_TENANT, 0.0)
    answer = live.client.post(f"/v1/sessions/{live.session_id()}/jobs", json={"callback_url": HOOK})
    assert answer.status_code == 202, answer.text
    assert answer.json()["spec"]["callback_url"] == HOOK
    assert live.client.post(f"/v1/sessions/{live.session_id()}/jobs").json()["spec"]["callback_url"] is None


@pytest.mark.parametrize(
    ("url", "code"),
    [
        ("http://portal.example/", "callback_not_https"),
        ("https://127.0.0.1/", "callback_not_public"),
        ("https://10.0.0.1:8443/", "callback_not_public"),
        ("https://[::1]/", "callback_not_public"),
        ("https://169.254.169.254/latest/meta-data", "callback_not_public"),
        ("https://user:secret@portal.example/", "wrong_format"),
        ("ftp://portal.example/", "wrong_format"),
        ("https:///hook", "wrong_format"),
        ("https://portal.example/#part", "wrong_format"),
        ("https://portal.example:99999/", "callback_invalid"),
        ("https://portal.example/a b", "wrong_format"),
        ("https://portal.example:0/", "callback_invalid"),
        ("https://[2606:4700::1111]evil.example/", "callback_invalid"),
        ("https://x[2606:4700::1111]/", "callback_invalid"),
        ("https://portal.example/\x07", "callback_invalid"),
        ("https://a..b/", "callback_invalid"),
        ("https://a\uff0eb/", "callback_invalid"),
        (f"https://{'a' * 64}.example/", "callback_invalid"),
        ("https://xn--999999999.example/", "callback_invalid"),
        ("https://2130706433/", "callback_invalid"),
        ("https://0x7f.1/", "callback_invalid"),
        ("https://0177.0.0.1/", "callback_invalid"),
        ("https://127.1/", "callback_invalid"),
        ("https://portal.example/\u00fc", "callback_invalid"),
        ("https://localhost/", "callback_not_public"),
        ("https://hook.localhost./", "callback_not_public"),
        ("https://[fec0::1]/", "callback_not_public"),
        ("https://[3fff::1]/", "callback_not_public"),
        ("https://[64:ff9b::808:808]/", "callback_not_public"),
        ("https://192.88.99.1/", "callback_not_public"),
        ("https://192.0.0.9/", "callback_not_public"),
    ],
)
def test_addresses_that_are_refused(live: Live, url: str, code: str) -> None:
    live.services.store.webhook_secrets.rotate(DEFAULT_TENANT, 0.0)
    answer = live.client.post(f"/v1/sessions/{live.session_id()}/jobs", json={"callback_url": url})
    problem = problem_of(answer, 422, "invalid_request")
    assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [(code, "/callback_url")]


def test_without_secret_nobody_can_be_told(make_settings: Callable[..., Settings]) -> None:
    spec = ("spec", (None, '{"callback_url": "http://portal.example/"}'))
    with running(make_settings()) as live:
        problem = problem_of(live.client.post("/v1/jobs", files=[*form(), spec]), 422, "invalid_request")
        assert [item["code"] for item in problem["errors"]] == ["callback_not_https", "webhook_secret_missing"]
        assert {item["pointer"] for item in problem["errors"]} == {"/spec/callback_url"}
        assert "multicap webhooks rotate" in problem["errors"][1]["hint"]
        assert live.kept() == []


def test_private_addresses_where_operator_allows_them(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(webhook_private=True)) as live:
        live.services.store.webhook_secrets.rotate(DEFAULT_TENANT, 0.0)
        body = {"callback_url": "http://127.0.0.1:9/"}
        assert live.client.post(f"/v1/sessions/{live.session_id()}/jobs", json=body).status_code == 202
