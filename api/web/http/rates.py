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
    """Counts of the last minute by key, in this process: requests by tenant, or wrong keys by network of the client.

    ``per_minute`` are allowed; ``None``: any number. More are answered by 429, with the code, the sentence, in which
    the limit stands, and the hint.
    """

    def __init__(self, per_minute: int | None, code: Code, sentence: str, hint: str, max_keys: int = _MAX_KEYS) -> None:
        self._minute = None if per_minute is None else MovingMinute(per_minute, max_keys)
        self._code, self._sentence, self._hint = code, sentence, hint

    def count(self, key: str) -> dict[str, str]:
        """Count an event; raise 429 above the limit.

        Returns ``RATE_HEADERS`` with their values; empty without a limit.
        """
        if self._minute is None:
            return {}
        state, limit = self._minute.hit(key), self._minute.limit
        values = (limit, state.remaining, max(1, math.ceil(state.reset_s)))
        headers = dict(zip(RATE_HEADERS, map(str, values), strict=True))
        if state.is_allowed:
            return headers
        headers["Retry-After"] = headers["RateLimit-Reset"]
        raise ApiError(self._code, self._sentence.format(limit), hint=self._hint, retryable=True, headers=headers)

    def __len__(self) -> int:
        """Number of keys with counts."""
        return 0 if self._minute is None else len(self._minute)


def request_rates(per_minute: int | None) -> Rates:
    """Limit of the requests of each tenant."""
    hint = "Send fewer requests: an event stream reports all changes of a job in one request."
    return Rates(per_minute, TOO_MANY_REQUESTS, "At most {} requests a minute are allowed.", hint)


def wrong_key_rates(per_minute: int, max_networks: int = _MAX_KEYS) -> Rates:
    """Limit of the wrong keys of each client network; wrong keys within it are answered by 401."""
    sentence = "More than {} wrong keys came from this address within a minute."
    hint = "Correct the key. A valid key is served at once."
    return Rates(per_minute, TOO_MANY_WRONG_KEYS, sentence, hint, max_networks)


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
