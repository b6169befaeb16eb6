"""How many requests a tenant may make."""

import math
import time

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import MovingWindowRateLimiter

from api.errors import ApiError

RATE_HEADERS = ("RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset")
"""By the IETF's draft: how many requests a minute, how many of them are left, and seconds until there are more."""


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
        wait_s = max(1, math.ceil(stats.reset_time - time.time()))
        headers = dict(zip(RATE_HEADERS, map(str, (self._item.amount, stats.remaining, wait_s)), strict=True))
        if allowed:
            return headers
        raise ApiError(
            429,
            "too_many_requests",
            f"At most {self._item.amount} requests a minute are allowed.",
            hint="Ask less often: event streams tell of a job's changes by one request.",
            retryable=True,
            headers={"Retry-After": str(wait_s), **headers},
        )
