"""Addresses of every special-purpose network, and public addresses beside them."""

# Some addresses of every network in the two IANA registries of special-purpose addresses, and of multicast: the first
# and the last address, unless they belong to another network.
SPECIAL = {
    "this network": ["0.0.0.0", "0.255.255.255"],  # noqa: S104
    "private use": ["10.0.0.1", "10.255.255.255", "172.16.0.1", "172.31.255.255", "192.168.0.0", "192.168.255.255"],
    "shared address space": ["100.64.0.1", "100.127.255.255"],
    "loopback": ["127.0.0.1", "127.1.2.3", "127.255.255.255"],
    "link local": ["169.254.0.0", "169.254.169.254"],
    "IETF protocols": ["192.0.0.0", "192.0.0.8", "192.0.0.9", "192.0.0.10", "192.0.0.170", "192.0.0.255"],
    "documentation": ["192.0.2.1", "198.51.100.255", "203.0.113.7"],
    "AS112": ["192.31.196.1", "192.175.48.6", "2001:4:112::1", "2620:4f:8000::6"],
    "AMT": ["192.52.193.1", "2001:3::1"],
    "6to4 relay": ["192.88.99.0", "192.88.99.2", "192.88.99.255"],
    "benchmarking": ["198.18.0.0", "198.19.255.255", "2001:2::1"],
    "multicast": ["224.0.0.1", "239.255.255.255", "ff00::", "ff02::1", "ff0e::1"],
    "reserved, broadcast": ["240.0.0.0", "255.255.255.255"],
    "unspecified, loopback of IPv6": ["::", "::1"],
    "IPv4-compatible": ["::8.8.8.8", "::127.0.0.1"],
    "IPv4-mapped": ["::ffff:127.0.0.1", "::ffff:8.8.8.8"],
    "translated": ["::ffff:0:8.8.8.8", "64:ff9b::7f00:1", "64:ff9b::808:808", "64:ff9b:1::a00:1", "64:ff9b:1:ffff::1"],
    "discard, dummy": ["100::1", "100:0:0:1::1"],
    "protocols of IPv6": ["2001::", "2001:1ff:ffff::", "2001:1::1", "2001:1::2", "2001:1::3"],
    "Teredo": ["2001:0:4136:e378:8000:63bf:3fff:fdd2"],
    "ORCHID, ORCHIDv2, DETs": ["2001:10::1", "2001:20::1", "2001:2f:ffff::", "2001:30::1"],
    "documentation of IPv6": ["2001:db8::1", "2001:db8:ffff::1", "3fff::", "3fff:fff:ffff::"],
    "6to4": ["2002:7f00:1::", "2002:808:808::", "2002:ffff::1"],
    "SRv6": ["5f00::", "5f00:ffff::1"],
    "unique local": ["fc00::1", "fd00::1", "fdff:ffff::"],
    "link and site local": ["fe80::1", "febf::1", "fec0::1", "feff::1"],
    "with a zone": ["fe80::1%lo", "2606:4700::1111%1"],
}


PRIVATE = [address for addresses in SPECIAL.values() for address in addresses]


PUBLIC = [
    "1.1.1.1", "8.8.8.8", "9.255.255.255", "11.0.0.0", "100.63.255.255", "100.128.0.0", "126.255.255.255", "128.0.0.0",
    "172.15.255.255", "172.32.0.0", "192.0.1.0", "192.0.3.0", "192.88.98.255", "192.88.100.0", "198.17.255.255",
    "198.20.0.0", "223.255.255.255", "2001:200::1", "2001:4860:4860::8888", "2003::1", "2606:4700::1111",
    "2a00:1450:4001::1", "3ffe:ffff::", "3fff:1000::",
]  # fmt: skip
