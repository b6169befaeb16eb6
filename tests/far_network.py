"""A network behind a router that forgets connections: network namespaces, whose router drops packets silently."""

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import psutil
import pytest


@dataclass
class FarNetwork:
    """Namespace of servers, which this machine reaches through the namespace of a router."""

    name: str
    address: str
    _rules: list[tuple[str, ...]] = field(default_factory=list)

    @property
    def prefix(self) -> Sequence[str]:
        """Command that runs another one among the servers."""
        return ["ip", "netns", "exec", self.servers]

    @property
    def servers(self) -> str:
        return f"{self.name}-servers"

    @property
    def router(self) -> str:
        return f"{self.name}-router"

    def forget(self, port: int) -> int:
        """Drop all packets of the open connections to a port, and return their number; new ones are routed."""
        flows = {
            connection.laddr.port
            for connection in psutil.net_connections("tcp")
            if connection.status == psutil.CONN_ESTABLISHED
            and (connection.raddr.ip, connection.raddr.port) == (self.address, port)
        }
        for flow in flows:
            self._drop("to", self.address, "ipproto", "tcp", "sport", str(flow), "dport", str(port))
            self._drop("from", self.address, "ipproto", "tcp", "sport", str(port), "dport", str(flow))
        return len(flows)

    @contextlib.contextmanager
    def cut(self, port: int) -> Iterator[None]:
        """Drop all packets to and from a port during the block."""
        rules = [
            ("to", self.address, "ipproto", "tcp", "dport", str(port)),
            ("from", self.address, "ipproto", "tcp", "sport", str(port)),
        ]
        for rule in rules:
            self._drop(*rule)
        try:
            yield
        finally:
            for rule in rules:
                self._route(rule)

    def restore(self) -> None:
        """Route all packets again: ports of forgotten connections may be used by new ones."""
        for rule in list(self._rules):
            self._route(rule)

    def _drop(self, *rule: str) -> None:
        _ip("-n", self.router, "rule", "add", *rule, "blackhole")
        self._rules.append(rule)

    def _route(self, rule: tuple[str, ...]) -> None:
        _ip("-n", self.router, "rule", "del", *rule, "blackhole")
        self._rules.remove(rule)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@contextlib.contextmanager
def far_network() -> Iterator[FarNetwork]:
    """Make a network during the block; skip the test if this machine does not allow it."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("networks can't be made: needs root and ip")
    number = os.getpid() % 50_000
    subnet = f"10.{128 + number // 250 % 100}.{number % 250}"
    network = FarNetwork(f"mc{number}", f"{subnet}.130")
    here = f"mc{number}"
    try:
        try:
            _ip("netns", "add", network.router)
            _ip("netns", "add", network.servers)
            _ip("link", "add", here, "type", "veth", "peer", "name", "near", "netns", network.router)
        except subprocess.CalledProcessError as error:
            pytest.skip(f"networks can't be made: {error.stderr.decode().strip()}")
        peer = ["peer", "name", "server", "netns", network.servers]
        _ip("-n", network.router, "link", "add", "far", "type", "veth", *peer)
        for where, device, address in (
            ([], here, f"{subnet}.1/25"),
            (["-n", network.router], "near", f"{subnet}.2/25"),
            (["-n", network.router], "far", f"{subnet}.129/25"),
            (["-n", network.servers], "server", f"{subnet}.130/25"),
        ):
            _ip(*where, "address", "add", address, "dev", device)
            _ip(*where, "link", "set", device, "up")
        _ip("-n", network.servers, "link", "set", "lo", "up")
        _ip("-n", network.servers, "route", "add", "default", "via", f"{subnet}.129")
        _ip("route", "add", f"{subnet}.128/25", "via", f"{subnet}.2")
        forward = ["sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward"]
        subprocess.run(["ip", "netns", "exec", network.router, *forward], check=True)
        yield network
    finally:
        for command in (["link", "del", here], ["netns", "del", network.servers], ["netns", "del", network.router]):
            with contextlib.suppress(subprocess.CalledProcessError):
                _ip(*command)
