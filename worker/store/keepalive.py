"""Times after which a connection without answers counts as dead, for the database and the broker.

A firewall that forgets a connection drops its packets silently. Without these times the kernel sends them again for a
quarter of an hour, and an idle connection looks whole for ever.
"""

import socket
from collections.abc import Mapping

IDLE_S, INTERVAL_S, NUM_PROBES = 5, 3, 3
"""Idle time before the first probe, time between probes, number of probes without an answer."""
UNACKNOWLEDGED_S = 15
"""Time that sent data may stay unacknowledged."""

SOCKET_OPTIONS: Mapping[int, int] = {
    getattr(socket, name): value
    for name, value in (
        ("TCP_KEEPIDLE", IDLE_S),
        ("TCP_KEEPINTVL", INTERVAL_S),
        ("TCP_KEEPCNT", NUM_PROBES),
        ("TCP_USER_TIMEOUT", 1000 * UNACKNOWLEDGED_S),  # not on every system
    )
    if hasattr(socket, name)
}
"""Options of a TCP socket by their numbers."""
