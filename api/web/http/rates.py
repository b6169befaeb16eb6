"""Rate limits of a process: requests of each tenant, wrong keys of each client network, messages of a connection.

The monotonic clock counts: a step of the system's clock shortens and prolongs no minute.
"""

import ipaddress
import math
import threading
import time
from collections import OrderedDict, deque
from typing import NamedTuple

from starlette.requests import HTTPConnection

from api.web.errors import ApiError
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.request_codes import TOO_MANY_REQUESTS, TOO_MANY_WRONG_KEYS

RATE_HEADERS = ("RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset")
"""Headers of the IETF's draft: requests a minute, requests left, and seconds until the limit resets."""

_IPV6_NETWORK_BITS = 64
_MINUTE_S = 60.0
_MAX_KEYS = 10_000


def address_network(host: str) -> str:
    """Network whose addresses count as one client: an IPv4 address, or the /64 of an IPv6 address.

    A subscriber of IPv6 has at least a /64. A host that is not an IP address is returned unchanged.

    >>> address_network("192.0.2.7"), address_network("::ffff:192.0.2.7"), address_network("2001:db8:1:2:3::4")
    ('192.0.2.7', '192.0.2.7', '2001:db8:1:2::/64')
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.IPv6Network((int(address), _IPV6_NETWORK_BITS), strict=False))


def client_network(connection: HTTPConnection) -> str:
    """Network of a request's client; behind a trusted proxy, the network of the address that the proxy names."""
    return address_network(connection.client.host) if connection.client else "unknown"


class MinuteState(NamedTuple):
    """Events that a key may have within the minute that ends now."""

    is_allowed: bool  # True if the last event was, or the next one is, within the limit
    remaining: int  # Further events that are within the limit
    reset_s: float  # Time until the oldest event of the minute no longer counts


class MovingMinute:
    """Times of the events of the last minute by key.

    ``limit`` events of a key are within the limit; others are not counted. Of more than ``max_keys`` keys the one
    without an event for longest is dropped.
    """

    def __init__(self, limit: int, max_keys: int = _MAX_KEYS) -> None:
        self.limit, self._max_keys = limit, max_keys
        self._times_s: OrderedDict[str, deque[float]] = OrderedDict()
        self._lock = threading.Lock()

    def hit(self, key: str) -> MinuteState:
        """Count an event if it is within the limit."""
        now_s = time.monotonic()
        with self._lock:
            times_s = self._times_s.setdefault(key, deque())
            self._times_s.move_to_end(key)
            if len(self._times_s) > self._max_keys:
                self._times_s.popitem(last=False)
            is_allowed = self._state(times_s, now_s).is_allowed
            if is_allowed:
                times_s.append(now_s)
            return self._state(times_s, now_s)._replace(is_allowed=is_allowed)

    def state(self, key: str) -> MinuteState:
        """Return what the next event of a key would meet."""
        with self._lock:
            return self._state(self._times_s.get(key, deque()), time.monotonic())

    def _state(self, times_s: deque[float], now_s: float) -> MinuteState:
        while times_s and now_s - times_s[0] >= _MINUTE_S:
            times_s.popleft()
        reset_s = times_s[0] + _MINUTE_S - now_s if times_s else 0.0
        return MinuteState(len(times_s) < self.limit, self.limit - len(times_s), reset_s)

    def __len__(self) -> int:
        """Number of keys with counts."""
        return len(self._times_s)


class Rates:
    """Counts of the requests of the last minute by tenant, in this process.

    A tenant may make ``per_minute`` requests; ``None``: any number.
    """

    def __init__(self, per_minute: int | None) -> None:
        self._minute = None if per_minute is None else MovingMinute(per_minute)

    def count(self, tenant: str) -> dict[str, str]:
        """Count a request; raise 429 above the limit.

        Returns ``RATE_HEADERS`` with their values; empty without a limit.
        """
        if self._minute is None:
            return {}
        state, limit = self._minute.hit(tenant), self._minute.limit
        if state.is_allowed:
            return _headers(limit, state)
        raise _too_many(
            TOO_MANY_REQUESTS,
            f"At most {limit} requests a minute are allowed.",
            "Send fewer requests: an event stream reports all changes of a job in one request.",
            _headers(limit, state),
        )


class WrongKeys:
    """Counts of wrong keys by client network, in this process.

    ``per_minute`` of a network are answered by 401, more by 429.
    """

    def __init__(self, per_minute: int, max_networks: int = _MAX_KEYS) -> None:
        self._minute = MovingMinute(per_minute, max_networks)

    def count(self, network: str) -> dict[str, str]:
        """Count a wrong key; raise 429 above the limit. Returns ``RATE_HEADERS`` with their values."""
        state, limit = self._minute.hit(network), self._minute.limit
        if state.is_allowed:
            return _headers(limit, state)
        raise _too_many(
            TOO_MANY_WRONG_KEYS,
            f"More than {limit} wrong keys came from this address within a minute.",
            "Correct the key. A valid key is served at once.",
            _headers(limit, state),
        )

    def __len__(self) -> int:
        """Number of networks with counts."""
        return len(self._minute)


def _headers(limit: int, state: MinuteState) -> dict[str, str]:
    values = (limit, state.remaining, max(1, math.ceil(state.reset_s)))
    return dict(zip(RATE_HEADERS, map(str, values), strict=True))


def _too_many(code: Code, detail: str, hint: str, headers: dict[str, str]) -> ApiError:
    retry_after = {"Retry-After": headers["RateLimit-Reset"]}
    return ApiError(code, detail, hint=hint, retryable=True, headers=retry_after | headers)


class Pace:
    """Average rate of messages, with a second's messages at once at most."""

    def __init__(self, per_s: float) -> None:
        self._per_s, self._left, self._at_s = per_s, max(per_s, 1.0), time.monotonic()

    def has_room(self) -> bool:
        """Count a message, unless it is above the rate; return whether it is within."""
        now_s = time.monotonic()
        self._left = min(max(self._per_s, 1.0), self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
