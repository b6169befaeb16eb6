"""Which addresses are of the internet at large."""

import ipaddress


def is_public(address: str) -> bool:
    """Whether an IP address is one of the internet at large.

    >>> is_public("8.8.8.8"), is_public("10.0.0.1"), is_public("::ffff:127.0.0.1")
    (True, False, False)
    """
    ip = ipaddress.ip_address(address)
    # Addresses of IPv6 that stand for one of IPv4 lead wherever that one does.
    wrapped = isinstance(ip, ipaddress.IPv6Address) and (ip.ipv4_mapped or ip.sixtofour or ip.teredo)
    return ip.is_global and not (wrapped or ip.is_multicast or ip.is_reserved)
