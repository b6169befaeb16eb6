"""Certificates of `multicap serve --https`: one made on the spot by an authority in the data folder, or a given one."""

import datetime
import ipaddress
import json
import socket
import ssl
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil
import trustme
from cryptography import x509

_FOLDER = "certificates"
# Browsers of phones refuse certificates that are valid for longer than 825 days; a new one is made at each start.
_VALID_DAYS = 397
_AUTHORITY = "Multicap on"
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
    """Certificate for the names and addresses of this machine, by the authority of a data folder.

    The authority is made at the first time and kept: phones that trust it need no change when the service starts again
    or the machine gets another address.
    """
    folder = data_dir / _FOLDER
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    authority, authority_key = folder / "authority.pem", folder / "authority-key.pem"
    try:
        if authority.exists() and authority_key.exists():
            issuer = trustme.CA.from_pem(authority.read_bytes(), authority_key.read_bytes())
        else:
            issuer = trustme.CA(organization_name="Multicap", organization_unit_name=f"{_AUTHORITY} {_host_name()}")
            issuer.private_key_pem.write_to_path(str(authority_key))
            issuer.cert_pem.write_to_path(str(authority))
        names = tuple(machine_names())
        until = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=_VALID_DAYS)
        issued = issuer.issue_cert(*names, organization_name="Multicap", not_after=until)
    except (ValueError, OSError) as error:
        message = f"The certificates in {folder} can't be used. Remove the folder: phones then trust another authority."
        raise CertificateError(message) from error
    certificate, key = folder / "certificate.pem", folder / "certificate-key.pem"
    issued.private_key_pem.write_to_path(str(key))
    certificate.write_bytes(b"".join(pem.bytes() for pem in issued.cert_chain_pems))
    return Encryption(certificate, key, authority, names)


def given_encryption(certificate: Path, key: Path) -> Encryption:
    """Certificate of the operator's own with its key; raises ``CertificateError`` if they do not belong together."""
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key, password=_no_password)
        names = tuple(_names_of(x509.load_pem_x509_certificate(certificate.read_bytes())))
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
    """Addresses and names of this machine, that of the way to its network first, without doubles."""
    found = [*_way_out(), *_addresses(), _host_name(), f"{_host_name()}.local", "localhost", "127.0.0.1", "::1"]
    yield from dict.fromkeys(name for name in found if name)


def _way_out() -> Iterator[str]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
        try:
            way.connect(_ELSEWHERE)
        except OSError:  # no network
            return
        yield way.getsockname()[0]


def _addresses() -> Iterator[str]:
    """Addresses of this machine that others may reach, of IPv4 first."""
    found = [
        ipaddress.ip_address(address.address)
        for addresses in psutil.net_if_addrs().values()
        for address in addresses
        if address.family in {socket.AF_INET, socket.AF_INET6} and "%" not in address.address
    ]
    yield from (str(address) for address in sorted(found, key=lambda one: one.version) if not address.is_loopback)


def _host_name() -> str:
    name = socket.gethostname().partition(".")[0].lower()
    return name if name.isascii() and name.replace("-", "").isalnum() else ""


def _names_of(certificate: x509.Certificate) -> Iterator[str]:
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
