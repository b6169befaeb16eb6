"""Addresses of outputs of a live capture: the scheme names the protocol. Standard library only."""

import ipaddress
import socket
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from types import MappingProxyType
from urllib.parse import parse_qsl, urlsplit

from pipeline.core.errors import InputError, Problem
from pipeline.core.options.rules import collecting, require
from pipeline.core.problems.finding_codes import PARAMETER_RANGE

_LOOPBACK = "127.0.0.1"
_MAX_PEOPLE, _MAX_NAME, _NUM_PORTS = 32, 64, 65_536


@dataclass(frozen=True, slots=True)
class OutputProtocol:
    """Protocol of outputs."""

    label: str  # Name for people
    factory: str  # Class of the output, a ``LiveOutput``, as ``package.module:name``
    port: int | None = None  # Usual port; ``None``: the address has the name of a stream in the place of host and port
    num_ports: int | None = 1  # Ports from the stated one on; ``None``: one for each person
    is_server: bool = False  # True: it listens at its address, and receivers connect
    options: Mapping[str, Sequence[str]] = field(default_factory=dict)  # Values that parameters of the address may have
    package: str | None = None  # Package that is not always installed; the scheme is the extra that installs it


_ROOM = "pipeline.run.live.outputs"
_PEOPLE = tuple(map(str, range(1, _MAX_PEOPLE + 1)))

OUTPUTS: Mapping[str, OutputProtocol] = MappingProxyType(
    {
        "vmc": OutputProtocol(
            "VMC", f"{_ROOM}.vmc:VmcOutput", 39539, None, options={"people": _PEOPLE, "person": _PEOPLE}
        ),
        "osc": OutputProtocol("OSC", f"{_ROOM}.osc:OscOutput", 9000, options={"people": _PEOPLE, "up": ("y", "z")}),
        "qtm": OutputProtocol("Qualisys RT", f"{_ROOM}.qtm:QtmOutput", 22222, 5, is_server=True),
        "mvn": OutputProtocol("Xsens MVN", f"{_ROOM}.mvn:MvnOutput", 9763),
        "rokoko": OutputProtocol("Rokoko", f"{_ROOM}.rokoko:RokokoOutput", 14043),
        "lsl": OutputProtocol("LSL", f"{_ROOM}.lsl:LslOutput", options={"people": _PEOPLE}, package="pylsl"),
    }
)
"""Protocol of outputs by the scheme of their addresses."""


@dataclass(frozen=True, slots=True)
class OutputAddress:
    """Address of an output."""

    scheme: str
    host: str  # IP address; of a protocol without ports the name of the stream
    port: int  # 0 of a protocol without ports
    options: Mapping[str, str]  # Parameters that are stated
    is_network: bool = False  # True: other machines are reached, or may connect

    @property
    def protocol(self) -> OutputProtocol:
        """Protocol of the scheme."""
        return OUTPUTS[self.scheme]

    @property
    def text(self) -> str:
        """Address as people write it."""
        options = "&".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self._at(self.port)}?{options}" if options else self._at(self.port)

    @property
    def places(self) -> list[str]:
        """Addresses of all ports, or of the stream, without parameters."""
        num_ports = self.protocol.num_ports or int(self.options.get("people", 1))
        return [self._at(port) for port in range(self.port, self.port + num_ports)]

    def _at(self, port: int) -> str:
        place = f"[{self.host}]:{port}" if ":" in self.host else f"{self.host}:{port}"
        return f"{self.scheme}://{self.host if self.protocol.port is None else place}"


def read_outputs(texts: Sequence[str], allow_network: bool) -> list[OutputAddress]:
    """Read addresses such as ``vmc://192.168.0.20:39539``; names of hosts are resolved.

    ``allow_network``: whether other machines may be reached: the protocols have neither keys nor encryption. Raises
    ``InputError`` with the problems of all addresses.
    """
    with collecting() as collect:
        addresses = [collect(partial(_read, text.strip(), allow_network)) for text in texts]
        counts = Counter(place for address in addresses if address is not None for place in address.places)
        collect(lambda: require(_problem(f"{text} is stated twice.") for text, count in counts.items() if count > 1))
    return [address for address in addresses if address is not None]


def _read(text: str, allow_network: bool) -> OutputAddress:
    scheme, sign, rest = text.partition("://")
    scheme = scheme.lower()
    if not sign or scheme not in OUTPUTS:
        usual = ", ".join(map(example, OUTPUTS))
        raise InputError([_problem(f"{text!r:.80} is no address of an output.", f"Write {usual}.")])
    protocol = OUTPUTS[scheme]
    place, _, query = rest.partition("?")
    try:
        options = _read_options(query)
        host, port = (place, 0) if protocol.port is None else _host_and_port(place, protocol)
    except ValueError:
        host, port, options = "", -1, {}
    is_wrong_name = protocol.port is None and (len(host) > _MAX_NAME or not host.isprintable())
    if port < 0 or is_wrong_name or not (host or protocol.is_server):
        message = f"{text!r:.80} is no address of {protocol.label}."
        raise InputError([_problem(message, f"Write {example(scheme)}.")])
    require(_wrong_options(protocol, options))
    if protocol.package is not None and find_spec(protocol.package) is None:
        hint = f"Run pip install 'multicap[{scheme}]'."
        raise InputError([_problem(f"{protocol.label} needs the package {protocol.package}.", hint)])
    resolved = host if protocol.port is None else _resolved(host or _LOOPBACK)
    is_network = protocol.port is None or not ipaddress.ip_address(resolved.partition("%")[0]).is_loopback
    if is_network and not allow_network:
        accepts = protocol.is_server or protocol.port is None
        reach = "accepts other machines" if accepts else "is on another machine"
        message = f"{text!r:.80} {reach}, and {protocol.label} has neither keys nor encryption."
        hint = "Allow the network." if protocol.port is None else f"Use {_LOOPBACK}, or allow the network."
        raise InputError([_problem(message, hint)])
    address = OutputAddress(scheme, resolved, port, options, is_network)
    if port + len(address.places) > _NUM_PORTS:
        raise InputError(
            [_problem(f"{text!r:.80} needs {len(address.places)} ports, and {_NUM_PORTS - 1} is the last.")]
        )
    return address


def _read_options(query: str) -> dict[str, str]:
    """Parameters of an address; raises ``ValueError`` if one has no value or is stated twice."""
    pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    options = dict(pairs)
    if len(options) < len(pairs):
        raise ValueError("a parameter is stated twice")
    return options


def _host_and_port(place: str, protocol: OutputProtocol) -> tuple[str, int]:
    """Host and port; raises ``ValueError`` if there is more, such as a path."""
    url = urlsplit(f"//{place}")
    port = (protocol.port or 0) if url.port is None else url.port
    if url.path.strip("/") or url.fragment or url.username is not None or not (port or protocol.is_server):
        raise ValueError("no host and port")
    return url.hostname or "", port


def _wrong_options(protocol: OutputProtocol, options: Mapping[str, str]) -> Iterator[Problem]:
    for name, value in options.items():
        if name not in protocol.options:
            known = ", ".join(protocol.options) or "none"
            yield _problem(f"Addresses of {protocol.label} have no parameter {name!r:.40}.", f"Parameters: {known}.")
        elif value not in protocol.options[name]:
            first, *_, last = protocol.options[name]
            yield _problem(f"{name} of an output is {first} to {last}, not {value!r:.40}.")


def example(scheme: str) -> str:
    """Form of the addresses of a protocol."""
    protocol = OUTPUTS[scheme]
    if protocol.port is None:
        return f"{scheme}://NAME"
    return f"{scheme}://:{protocol.port}" if protocol.is_server else f"{scheme}://HOST:{protocol.port}"


def _resolved(host: str) -> str:
    try:
        address = socket.getaddrinfo(host, None, type=socket.SOCK_DGRAM)[0][4]
        return socket.getnameinfo(address, socket.NI_NUMERICHOST)[0]  # With the scope of a link-local address
    except (OSError, UnicodeError):
        raise InputError([_problem(f"The host {host!r:.80} is not known.", "Check the address.")]) from None


def _problem(message: str, hint: str | None = None) -> Problem:
    return Problem(PARAMETER_RANGE, message, field="output", hint=hint)
