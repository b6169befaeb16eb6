"""Certificates of `multicap serve --https`: one made on the spot by an authority in the data folder, or a given one."""

import datetime
import ipaddress
import json
import os
import socket
import ssl
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil
from cryptography import x509

from api.cli import certificate_authority

_FOLDER = "certificates"
_AUTHORITY, _CERTIFICATE, _KEY = "authority.pem", "certificate.pem", "certificate-key.pem"
# A certificate is replaced at the first start within this time before its end.
_RENEWED_BEFORE = datetime.timedelta(days=30)
# An address for documentation: a socket that is connected to it by UDP sends nothing, and tells the way out.
_ELSEWHERE = ("192.0.2.1", 9)


class CertificateError(Exception):
    """A certificate can't be used; the text states the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class Encryption:
    """Certificate of a service with its key, and names by which clients may call it."""

    certificate: Path
    key: Path
    authority: Path | None  # Certificate of the authority, for phones; ``None`` of a given certificate
    names: tuple[str, ...]  # Host names and addresses; the first one is for phones
    has_replaced: bool = False  # True if phones that trusted an earlier authority have to trust this one again

    def environment(self, port: int, allowed_hosts: Sequence[str], public_url: str | None) -> Mapping[str, str]:
        """Settings of the web API: the files, and addresses by which it may be called."""
        name = f"[{self.names[0]}]" if ":" in self.names[0] else self.names[0]
        return {
            "MULTICAP_CERTIFICATE": str(self.certificate),
            "MULTICAP_CERTIFICATE_KEY": str(self.key),
            **({} if self.authority is None else {"MULTICAP_CERTIFICATE_AUTHORITY": str(self.authority)}),
            "MULTICAP_ALLOWED_HOSTS": json.dumps(sorted({*allowed_hosts, *self.names})),
            "MULTICAP_PUBLIC_URL": public_url or f"https://{name}:{port}",
        }

    def client_context(self) -> ssl.SSLContext:
        """Context of a client on this machine, which trusts this certificate whatever name it has."""
        context = ssl.create_default_context(cafile=str(self.authority or self.certificate))
        context.check_hostname = False
        if self.authority is None:
            context.verify_mode = ssl.CERT_NONE  # of an authority that this machine may not know
        return context


def own_encryption(data_dir: Path) -> Encryption:
    """Certificate for the names and addresses of this machine, by an authority for it in a data folder.

    The key of the authority is never stored: what phones trust has signed this certificate, and can sign nothing else.
    Both are kept until shortly before their end, unless the machine has another name or another address in the network
    of its phones.
    """
    folder = data_dir / _FOLDER
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        is_there = any((folder / name).exists() for name in (_AUTHORITY, _CERTIFICATE, _KEY))
        if not is_there or (kept := _kept(folder)) is None:
            return _new(folder, has_replaced=is_there)
    except OSError as error:
        message = f"The certificates in {folder} can't be read or written: {error.strerror}. Check its owner and mode."
        raise CertificateError(message) from error
    return kept


def _kept(folder: Path) -> Encryption | None:
    """Certificate in a folder; ``None`` if it is damaged, ends soon, or lacks what phones and this machine call."""
    certificate, key, authority = folder / _CERTIFICATE, folder / _KEY, folder / _AUTHORITY
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key, password=_no_password)
        found, issuer = (x509.load_pem_x509_certificate(path.read_bytes()) for path in (certificate, authority))
        certified = set(_certificate_names(found))
    except (ssl.SSLError, FileNotFoundError, ValueError):
        return None
    names, until = list(machine_names()), datetime.datetime.now(datetime.UTC) + _RENEWED_BEFORE
    needed = [names[0], *(name for name in names if isinstance(certificate_authority.general_name(name), x509.DNSName))]
    if not certificate_authority.is_limited(issuer) or not all(
        certificate_authority.is_trusted(found, issuer, name, until) for name in needed
    ):
        return None
    return Encryption(certificate, key, authority, tuple(name for name in names if name in certified))


def _new(folder: Path, *, has_replaced: bool) -> Encryption:
    names, now = tuple(machine_names()), datetime.datetime.now(datetime.UTC)
    authority = certificate_authority.new_authority(_host_name() or "a machine", names, now)
    signed, key = authority.sign(names)
    contents = {
        _KEY: (certificate_authority.pem_of_key(key), 0o600),
        _CERTIFICATE: (certificate_authority.pem_of_certificate(signed), 0o644),
        _AUTHORITY: (certificate_authority.pem_of_certificate(authority.certificate), 0o644),
    }
    for name, (content, mode) in contents.items():
        part = folder / f"{name}.part"
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(content)
        part.replace(folder / name)
    return Encryption(folder / _CERTIFICATE, folder / _KEY, folder / _AUTHORITY, names, has_replaced)


def given_encryption(certificate: Path, key: Path) -> Encryption:
    """Certificate of the operator's own with its key; raises ``CertificateError`` if they do not belong together."""
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key, password=_no_password)
        names = tuple(_certificate_names(x509.load_pem_x509_certificate(certificate.read_bytes())))
    except (OSError, ValueError) as error:  # SSLError is an OSError
        message = (
            f"The certificate {certificate.name} can't be used with the key {key.name}: both must be readable PEM "
            "files that belong together, the key without a password."
        )
        raise CertificateError(message) from error
    if not names:
        message = f"The certificate {certificate.name} names no host; it needs one by which phones call this machine."
        raise CertificateError(message)
    return Encryption(certificate, key, None, names)


def machine_names() -> Iterator[str]:
    """Addresses and names of this machine, the address on the way to its network first, without doubles.

    Addresses of IPv6 change by themselves and are left out. So is the bare name of the machine: an authority for the
    name `dev` would be one for a whole top-level domain.
    """
    host = _host_name()
    local = [f"{host}.local"] if host else []
    yield from dict.fromkeys([*_way_out(), *_addresses(), *local, "localhost", "127.0.0.1", "::1"])


def _way_out() -> Iterator[str]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
        try:
            way.connect(_ELSEWHERE)
        except OSError:  # no network
            return
        yield way.getsockname()[0]


def _addresses() -> Iterator[str]:
    """Addresses of this machine by IPv4 that others may reach."""
    found = [
        ipaddress.IPv4Address(address.address)
        for addresses in psutil.net_if_addrs().values()
        for address in addresses
        if address.family == socket.AF_INET
    ]
    yield from (str(address) for address in sorted(found) if not address.is_loopback)


def _host_name() -> str:
    name = socket.gethostname().partition(".")[0].lower()
    return name if name.isascii() and name.replace("-", "").isalnum() else ""


def _certificate_names(certificate: x509.Certificate) -> Iterator[str]:
    """Names and addresses in a certificate by which a client may call the service."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return
    yield from (name for name in names.get_values_for_type(x509.DNSName) if "*" not in name)
    yield from map(str, names.get_values_for_type(x509.IPAddress))


def _no_password() -> str:
    """Refuse to ask for a password at the terminal."""
    return ""
