"""Networks of clients: requests without a key are counted by the network that they come from."""

import ipaddress

from starlette.requests import HTTPConnection

Network = ipaddress.IPv4Network | ipaddress.IPv6Network

_IPV6_NETWORK_BITS = 64


def network_of(host: str) -> str:
    """Network whose addresses count as one client: an IPv4 address, or the /64 of an IPv6 address.

    A subscriber of IPv6 has at least a /64. A host that is not an IP address is returned unchanged.

    >>> network_of("192.0.2.7"), network_of("::ffff:192.0.2.7"), network_of("2001:db8:1:2:3::4")
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
    return network_of(connection.client.host) if connection.client else "unknown"
