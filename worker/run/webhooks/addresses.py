"""Addresses of webhooks: the syntax of their URLs, and public IP addresses.

The tables are the IANA IPv4 and IPv6 Special-Purpose Address Registries (RFC 6890), with the networks of multicast. No
address of the registries counts as public, not even the addresses that they call globally reachable: translators,
anycast relays and sinks may lead to any network, and no receiver of webhooks has such an address.
"""

import ipaddress
import re
from urllib.parse import SplitResult, urlsplit

_SPECIAL_V4 = tuple(
    ipaddress.IPv4Network(network)
    for network in (
        "0.0.0.0/8", "10.0.0.0/8", "100.64.0.0/10", "127.0.0.0/8", "169.254.0.0/16", "172.16.0.0/12", "192.0.0.0/24",
        "192.0.2.0/24", "192.31.196.0/24", "192.52.193.0/24", "192.88.99.0/24", "192.168.0.0/16", "192.175.48.0/24",
        "198.18.0.0/15", "198.51.100.0/24", "203.0.113.0/24", "224.0.0.0/4", "240.0.0.0/4",
    )
)  # fmt: skip
# All allocated unicast addresses; loopback, private, link-local, mapped, translated and multicast lie outside.
_UNICAST_V6 = ipaddress.IPv6Network("2000::/3")
_SPECIAL_V6 = tuple(
    ipaddress.IPv6Network(network)
    # Protocols (Teredo, ORCHID, benchmarking, ...), documentation, 6to4, sinks, documentation.
    for network in ("2001::/23", "2001:db8::/32", "2002::/16", "2620:4f:8000::/48", "3fff::/20")
)

_MAX_NAME = 253
_LABEL = re.compile(r"(?!-)[a-z0-9_-]{1,63}(?<!-)", re.ASCII | re.IGNORECASE)
_BRACKETED = re.compile(r"\[[^\[\]]*\](:\d*)?", re.ASCII)
_NO_IPV6 = "The host of the address must be an IPv6 address in brackets, without a zone."
# Forms that resolvers accept as a number: decimal, octal or hexadecimal, with one to four parts.
_NUMERIC = re.compile(r"\d+|0x[0-9a-f]*", re.ASCII | re.IGNORECASE)


def is_public(address: str) -> bool:
    """True if an IP address is public; raises ``ValueError`` if the text is not an IP address.

    >>> is_public("8.8.8.8"), is_public("10.0.0.1"), is_public("::ffff:8.8.8.8")
    (True, False, False)
    """
    ip = ipaddress.ip_address(address)
    if isinstance(ip, ipaddress.IPv4Address):
        return not any(ip in network for network in _SPECIAL_V4)
    # An address with a zone belongs to a network of this machine.
    return ip.scope_id is None and ip in _UNICAST_V6 and not any(ip in network for network in _SPECIAL_V6)


def may_be_public(host: str) -> bool:
    """True if the host of a URL may be public: a public IP address, or any name but ``localhost``."""
    try:
        return is_public(host)
    except ValueError:  # A name: its addresses are checked when a message is sent.
        name = host.removesuffix(".").lower()
        return name != "localhost" and not name.endswith(".localhost")


def url_fault(url: str) -> str | None:
    """Sentence about a syntactic fault of a URL, or ``None``.

    >>> url_fault("https://portal.example/hook"), url_fault("https://a..b/")
    (None, 'The name of the host has an empty part.')
    """
    if not (url.isascii() and url.isprintable()):
        return "The address must be ASCII: write names with other letters as xn--..., and percent-encode the rest."
    try:
        parts = urlsplit(url)
        host = parts.hostname or ""
    except ValueError:
        return _NO_IPV6
    if not _has_port(parts):
        return "The port of the address must be a number from 1 to 65535."
    if "[" in parts.netloc:
        return None if _BRACKETED.fullmatch(parts.netloc) and _is_ipv6(host) else _NO_IPV6
    return _name_fault(host)


def _has_port(parts: SplitResult) -> bool:
    """True if the port is valid or omitted."""
    try:
        return parts.port != 0
    except ValueError:
        return False


def _is_ipv6(host: str) -> bool:
    try:
        return ipaddress.IPv6Address(host).scope_id is None
    except ValueError:
        return False


def _name_fault(host: str) -> str | None:
    labels = host.removesuffix(".").split(".")
    if "" in labels:
        return "The name of the host has an empty part."
    if _NUMERIC.fullmatch(labels[-1]):
        return None if _is_ipv4(host) else "An IP address must be four decimal numbers, such as 203.0.113.7."
    if len(host) > _MAX_NAME or not all(_LABEL.fullmatch(label) for label in labels):
        return "The host must be a domain name: at most 63 letters, digits and hyphens a part, at most 253 in all."
    if not all(map(_is_decodable, labels)):
        return "The name of the host has an invalid xn--... part."
    return None


def _is_ipv4(host: str) -> bool:
    try:
        ipaddress.IPv4Address(host)
    except ValueError:
        return False
    return True


def _is_decodable(label: str) -> bool:
    if not label.lower().startswith("xn--"):
        return True
    try:
        return bool(label[4:].encode("ascii").decode("punycode"))
    except ValueError:
        return False
