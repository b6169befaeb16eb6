"""Rate limits by the monotonic clock."""

import time

import pytest

from api.web.errors import ApiError
from api.web.http.rates import request_rates
from api.web.live.places import LivePlaces


def test_step_of_clock_prolongs_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    wall_s, now_s = time.time(), time.monotonic()
    rates, places = request_rates(2), LivePlaces(8, 8, 1, 1)
    for _ in range(2):
        rates.count("studio")
    places.note_bad("studio")
    with pytest.raises(ApiError, match="requests a minute"):
        rates.count("studio")
    with pytest.raises(ApiError, match="within a minute"), places.taken("studio"):
        pass
    monkeypatch.setattr(time, "time", lambda: wall_s - 3600.0)
    monkeypatch.setattr(time, "monotonic", lambda: now_s + 61.0)
    assert rates.count("studio")["RateLimit-Remaining"] == "1"
    with places.taken("studio"):
        pass


def test_limit_moves_with_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    clock_s = [0.0]
    monkeypatch.setattr("api.web.http.rates.time.monotonic", lambda: clock_s[0])
    rates = request_rates(2)
    for second in (0.0, 50.0):
        clock_s[0] = second
        rates.count("studio")
    clock_s[0] = 55.0
    with pytest.raises(ApiError) as raised:
        rates.count("studio")
    assert raised.value.headers["Retry-After"] == "5"
    clock_s[0] = 60.0
    assert rates.count("studio") == {"RateLimit-Limit": "2", "RateLimit-Remaining": "0", "RateLimit-Reset": "50"}
