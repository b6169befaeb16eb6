"""Wrong keys are counted by the client's address; valid keys are always served."""

import itertools
from collections.abc import Callable, Iterator

import httpx2
import pytest

from api.web.http.rates import wrong_key_rates
from api.web.settings import Settings
from tests.api.conftest import Live, problem_of, running
from worker.store.model.rights import Scope

LIMIT = 5
WRONG = {"Authorization": "Bearer mc_wrong"}


@pytest.fixture
def guarded(make_settings: Callable[..., Settings]) -> Iterator[tuple[Live, dict[str, str]]]:
    settings = make_settings(max_wrong_keys_per_minute=LIMIT, trusted_proxies=frozenset({"127.0.0.9"}))
    with running(settings) as live:
        _, secret = live.services.store.keys.add("studio", "portal", frozenset(Scope))
        yield live, {"Authorization": f"Bearer {secret}"}


def from_address(live: Live, host: str) -> httpx2.Client:
    return httpx2.Client(
        base_url=live.client.base_url, transport=httpx2.HTTPTransport(local_address=host), trust_env=False
    )


def use_up(client: httpx2.Client, **headers: str) -> None:
    for left in reversed(range(LIMIT)):
        answer = client.get("/v1/jobs", headers=WRONG | headers)
        problem_of(answer, 401, "key_required")
        assert answer.headers["ratelimit-limit"] == str(LIMIT)
        assert answer.headers["ratelimit-remaining"] == str(left)


@pytest.mark.slow
def test_too_many_wrong_keys_are_refused(guarded: tuple[Live, dict[str, str]]) -> None:
    live, valid = guarded
    use_up(live.client)
    answer = live.client.get("/v1/jobs", headers=WRONG)
    assert problem_of(answer, 429, "too_many_wrong_keys")["retryable"]
    assert 0 < int(answer.headers["retry-after"]) <= 60
    assert answer.headers["ratelimit-remaining"] == "0"
    assert answer.headers["ratelimit-reset"] == answer.headers["retry-after"]
    # Valid keys from the same address are served and not counted.
    assert live.client.get("/v1/jobs", headers=valid).status_code == 200
    secret = valid["Authorization"].removeprefix("Bearer ")
    assert live.client.post("/v1/browser-session", json={"key": secret}).status_code == 204
    assert live.client.get("/v1/jobs").status_code == 200  # authorized by the cookie
    with from_address(live, "127.0.0.2") as other:
        problem_of(other.get("/v1/jobs", headers=WRONG), 401, "key_required")


def test_wrong_keys_are_counted_at_entrance(guarded: tuple[Live, dict[str, str]]) -> None:
    live, _ = guarded
    answers = [live.client.post("/v1/browser-session", json={"key": "mc_guessed"}) for _ in range(LIMIT + 1)]
    assert [answer.status_code for answer in answers] == [401] * LIMIT + [429]


def test_old_cookie_leads_to_entrance(guarded: tuple[Live, dict[str, str]]) -> None:
    # Also beside somebody who has used up the wrong keys of the same address.
    live, _ = guarded
    use_up(live.client)
    for _ in range(LIMIT + 1):
        answer = live.client.get("/v1/jobs", headers={"Cookie": "multicap_session=ended"})
        problem_of(answer, 401, "key_required")
        assert answer.headers["set-cookie"].startswith('multicap_session=""; ')
        assert "Max-Age=0" in answer.headers["set-cookie"]


def test_requests_without_key_are_not_counted(guarded: tuple[Live, dict[str, str]]) -> None:
    live, _ = guarded
    assert {live.client.get("/v1/jobs").status_code for _ in range(3 * LIMIT)} == {401}


def test_trusted_proxy_names_client(guarded: tuple[Live, dict[str, str]]) -> None:
    live, _ = guarded
    with from_address(live, "127.0.0.9") as proxy:
        use_up(proxy, **{"X-Forwarded-For": "198.51.100.1"})
        refused = proxy.get("/v1/jobs", headers=WRONG | {"X-Forwarded-For": "198.51.100.1"})
        problem_of(refused, 429, "too_many_wrong_keys")
        # The first address was written by the client and is ignored.
        forged = proxy.get("/v1/jobs", headers=WRONG | {"X-Forwarded-For": "192.0.2.1, 198.51.100.1"})
        problem_of(forged, 429, "too_many_wrong_keys")
        other = proxy.get("/v1/jobs", headers=WRONG | {"X-Forwarded-For": "198.51.100.2"})
        problem_of(other, 401, "key_required")


def test_others_cannot_name_clients(guarded: tuple[Live, dict[str, str]]) -> None:
    live, _ = guarded
    answers = [
        live.client.get("/v1/jobs", headers=WRONG | {"X-Forwarded-For": f"198.51.100.{k}"}) for k in range(LIMIT + 1)
    ]
    assert [answer.status_code for answer in answers] == [401] * LIMIT + [429]


def test_wrong_keys_count_for_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(0.0, 25.0)
    monkeypatch.setattr("api.web.http.rates.time.monotonic", lambda: next(clock))
    wrong_keys = wrong_key_rates(5)
    left = [wrong_keys.count("192.0.2.1")["RateLimit-Remaining"] for _ in range(5)]  # at 0, 25, 50, 75, 100 s
    assert left == ["4", "3", "2", "2", "2"]


def test_networks_are_forgotten_before_they_fill_memory() -> None:
    wrong_keys = wrong_key_rates(2, max_networks=100)
    for k in range(1000):
        wrong_keys.count(f"192.0.2.{k}")
        wrong_keys.count("198.51.100.1") if k == 0 else None
    assert len(wrong_keys) == 100
    assert wrong_keys.count("192.0.2.999")["RateLimit-Remaining"] == "0"
    assert wrong_keys.count("198.51.100.1")["RateLimit-Remaining"] == "1"
