"""Rate limits of a process: requests of each tenant, and wrong keys of each client network."""

import math
import threading
import time
from collections import OrderedDict

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import MovingWindowRateLimiter

from api.errors import ApiError
from pipeline.problem_codes.model import Code
from pipeline.problem_codes.requests import TOO_MANY_REQUESTS, TOO_MANY_WRONG_KEYS

RATE_HEADERS = ("RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset")
"""Headers of the IETF's draft: requests a minute, requests left, and seconds until the limit resets."""

_MINUTE_S = 60.0
_MAX_NETWORKS = 10_000


class Rates:
    """Counts of the requests of the last minute by tenant, in this process.

    A tenant may make ``per_minute`` requests; ``None``: any number.
    """

    def __init__(self, per_minute: int | None) -> None:
        self._item = None if per_minute is None else RateLimitItemPerMinute(per_minute)
        self._limiter = MovingWindowRateLimiter(MemoryStorage())

    def count(self, tenant: str) -> dict[str, str]:
        """Count a request; raise 429 above the limit.

        Returns ``RATE_HEADERS`` with their values; empty without a limit.
        """
        if self._item is None:
            return {}
        allowed = self._limiter.hit(self._item, tenant)
        stats = self._limiter.get_window_stats(self._item, tenant)
        headers = _headers(self._item.amount, stats.remaining, stats.reset_time - time.time())
        if allowed:
            return headers
        raise _too_many(
            TOO_MANY_REQUESTS,
            f"At most {self._item.amount} requests a minute are allowed.",
            "Send fewer requests: an event stream reports all changes of a job in one request.",
            headers,
        )


class WrongKeys:
    """Counts of wrong keys by client network, in this process. A network's minute begins with its first wrong key.

    ``per_minute`` of a network are answered by 401, more by 429. Of more than ``max_networks`` the one that was quiet
    for longest is dropped.
    """

    def __init__(self, per_minute: int, max_networks: int = _MAX_NETWORKS) -> None:
        self._per_minute, self._max_networks = per_minute, max_networks
        # Start of the minute and count of each network, in the order of their last wrong keys.
        self._counts: OrderedDict[str, tuple[float, int]] = OrderedDict()
        self._lock = threading.Lock()

    def count(self, network: str) -> dict[str, str]:
        """Count a wrong key; raise 429 above the limit. Returns ``RATE_HEADERS`` with their values."""
        now_s = time.monotonic()
        with self._lock:
            start_s, count = self._counts.pop(network, (now_s, 0))
            if now_s - start_s >= _MINUTE_S:
                start_s, count = now_s, 0
            self._counts[network] = start_s, count + 1
            if len(self._counts) > self._max_networks:
                self._counts.popitem(last=False)
        headers = _headers(self._per_minute, max(0, self._per_minute - count - 1), start_s + _MINUTE_S - now_s)
        if count < self._per_minute:
            return headers
        raise _too_many(
            TOO_MANY_WRONG_KEYS,
            f"More than {self._per_minute} wrong keys came from this address within a minute.",
            "Correct the key. A valid key is served at once.",
            headers,
        )

    def __len__(self) -> int:
        """Number of networks with counts."""
        return len(self._counts)


def _headers(limit: int, remaining: int, reset_s: float) -> dict[str, str]:
    return dict(zip(RATE_HEADERS, map(str, (limit, remaining, max(1, math.ceil(reset_s)))), strict=True))


def _too_many(code: Code, detail: str, hint: str, headers: dict[str, str]) -> ApiError:
    retry_after = {"Retry-After": headers["RateLimit-Reset"]}
    return ApiError(code, detail, hint=hint, retryable=True, headers=retry_after | headers)
