"""How many requests a tenant may make, and how many wrong keys a client may show."""

import math
import threading
import time
from collections import OrderedDict

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import MovingWindowRateLimiter

from api.errors import ApiError

RATE_HEADERS = ("RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset")
"""By the IETF's draft: how many requests a minute, how many of them are left, and seconds until there are more."""

_MINUTE_S = 60.0
_MAX_NETWORKS = 10_000


class Rates:
    """Counts the requests of the last minute by tenant, in this process.

    Parameters
    ----------
    per_minute
        How many each may make; ``None``: any number.
    """

    def __init__(self, per_minute: int | None) -> None:
        self._item = None if per_minute is None else RateLimitItemPerMinute(per_minute)
        self._limiter = MovingWindowRateLimiter(MemoryStorage())

    def count(self, tenant: str) -> dict[str, str]:
        """Count a request; 429 if it is one too many.

        Returns
        -------
            Headers that say how many more there may be; none without a limit.
        """
        if self._item is None:
            return {}
        allowed = self._limiter.hit(self._item, tenant)
        stats = self._limiter.get_window_stats(self._item, tenant)
        headers = _headers(self._item.amount, stats.remaining, stats.reset_time - time.time())
        if allowed:
            return headers
        raise _too_many(
            "too_many_requests",
            f"At most {self._item.amount} requests a minute are allowed.",
            "Ask less often: event streams tell of a job's changes by one request.",
            headers,
        )


class WrongKeys:
    """Counts the wrong keys of each client network, in this process. A minute begins with the first of them.

    Parameters
    ----------
    per_minute
        Wrong keys of a network that are answered by 401; more are answered by 429.
    max_networks
        Networks that are remembered; of more, the one that was quiet for longest is forgotten.
    """

    def __init__(self, per_minute: int, max_networks: int = _MAX_NETWORKS) -> None:
        self._per_minute, self._max_networks = per_minute, max_networks
        # When the minute of a network began, and how many keys came in it; the last to show one stands last.
        self._counts: OrderedDict[str, tuple[float, int]] = OrderedDict()
        self._lock = threading.Lock()

    def count(self, network: str) -> dict[str, str]:
        """Count a wrong key; 429 if it is one too many.

        Returns
        -------
            Headers that say how many more there may be.
        """
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
            "too_many_wrong_keys",
            f"More than {self._per_minute} wrong keys came from this address within a minute.",
            "Correct the key. A valid key is served at once.",
            headers,
        )

    def __len__(self) -> int:
        """How many networks are remembered."""
        return len(self._counts)


def _headers(limit: int, remaining: int, reset_s: float) -> dict[str, str]:
    return dict(zip(RATE_HEADERS, map(str, (limit, remaining, max(1, math.ceil(reset_s)))), strict=True))


def _too_many(code: str, detail: str, hint: str, headers: dict[str, str]) -> ApiError:
    retry_after = {"Retry-After": headers["RateLimit-Reset"]}
    return ApiError(code, detail, hint=hint, retryable=True, headers=retry_after | headers)
